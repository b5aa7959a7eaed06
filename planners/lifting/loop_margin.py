"""How much stiffness and delay the leader-follower law bears before the hands and the lifter start to swing."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planners.lifting.leader_follower import FollowerGains, LeaderFollower


@dataclass(frozen=True)
class LoopMargin:
    """Distance of the closed loop from swinging; both must be greater than zero, or one, to be stable."""

    gain: float
    """Factor by which the stiffness may grow [1]."""
    phase: float
    """Lag that may be added at the frequency where the loop's gain is one [rad]."""
    delay: float
    """The same lag as a time [s]."""


def loop_margin(gains: FollowerGains, stiffness: float, delay: float) -> LoopMargin:
    """Return the margins of the sampled loop: law, velocity held over a period, spring, delay.

    L(z) = k P(z) C(z) z^(-delay / T) with the exactly discretised law C and P(z) = T / (z - 1), the height that a held
    velocity makes. It is conservative: without the limit V >= 0, which can only take energy out.

    Args:
        gains: of the law.
        stiffness: k, change of the pushing hand's force with the height of the hands over the lifter [N/m].
        delay: from the force at the sensor to the velocity of the hands, without the hold [s].
    """
    w = np.geomspace(1e-3, math.pi / gains.period, 20000)
    z = np.exp(1j * w * gains.period)
    loop = stiffness * gains.period / (z - 1.0) * _law(gains, z) * np.exp(-1j * w * delay)
    size, angle = np.abs(loop), np.unwrap(np.angle(loop))
    crossing = int(np.argmax(size < 1.0))
    phase = math.pi + angle[crossing]
    reversing = int(np.argmax(angle < -math.pi))
    gain = float(1.0 / size[reversing]) if angle.min() < -math.pi else math.inf
    return LoopMargin(gain, float(phase), float(phase / w[crossing]))


def _law(gains: FollowerGains, z: NDArray[np.complex128]) -> NDArray[np.complex128]:
    """Return the transfer function from E to V; V is put out in the period whose E it was computed from."""
    step = LeaderFollower(gains).discrete
    (a, b), (c, d) = step[:, :2]
    e, f = step[:, 2]
    # [lead, V] z = [[a, b], [c, d]] [lead, V] + [e, f] E, and V is taken after the step.
    return z * (c * e + (z - a) * f) / ((z - a) * (z - d) - b * c)
