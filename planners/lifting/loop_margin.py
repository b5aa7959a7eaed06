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
    """Factor by which stiffness and mass may grow together [1]."""
    phase: float
    """Lag that may be added at any frequency where the loop's gain is one [rad]."""
    delay: float
    """Delay that may be added, likewise [s]."""


def loop_margin(gains: FollowerGains, stiffness: float, mass: float, delay: float) -> LoopMargin:
    """Return the margins of the sampled loop: law, velocity held over a period, spring and mass, delay.

    L(z) = P(z) C(z) z^(-delay / T) with the exactly discretised law C and P(z) = k T / (z - 1) + m (z - 1) / (z T): the
    height that a held velocity makes, and its mean acceleration since the last reading. It is conservative: without
    the limit V >= 0, which can only take energy out.

    Args:
        gains: of the law.
        stiffness: k, change of the pushing hand's force with the height of the hands over the lifter [N/m].
        mass: m, that the pushing hand accelerates [kg].
        delay: from the force at the sensor to the velocity of the hands, without the hold [s].
    """
    w = np.geomspace(1e-3, math.pi / gains.period, 20000)
    z = np.exp(1j * w * gains.period)
    plant = stiffness * gains.period / (z - 1.0) + mass * (z - 1.0) / (z * gains.period)
    loop = plant * _law(gains, z) * np.exp(-1j * w * delay)
    size, angle = np.abs(loop), np.unwrap(np.angle(loop))
    # The mass may lift the loop's gain above one again near the sensor's rate: the worst crossing counts.
    crossings = np.flatnonzero(np.diff(size < 1.0)) + 1
    lags = math.pi + angle[crossings]
    phase, delay = lags.min(initial=math.inf), (lags / w[crossings]).min(initial=math.inf)
    # The loop is real and negative where its angle passes an odd multiple of pi.
    turns = np.floor((angle / math.pi + 1.0) / 2.0)
    reversals = np.flatnonzero(np.diff(turns))
    gain = float(1.0 / size[reversals].max()) if len(reversals) else math.inf
    return LoopMargin(gain, float(phase), float(delay))


def _law(gains: FollowerGains, z: NDArray[np.complex128]) -> NDArray[np.complex128]:
    """Return the transfer function from E to V; V is put out in the period whose E it was computed from."""
    step = LeaderFollower(gains).discrete
    (a, b), (c, d) = step[:, :2]
    e, f = step[:, 2]
    # [lead, V] z = [[a, b], [c, d]] [lead, V] + [e, f] E, and V is taken after the step.
    return z * (c * e + (z - a) * f) / ((z - a) * (z - d) - b * c)
