"""What two fingers that squeeze with a commanded force exert on the tool between them, in closed form.

A finger is a soft finger (paper B, 5c): its shear s and its torque t about the normal need
`sqrt(|s|^2 + (t / eps)^2) <= mu * normal`. Two of them face one another along the TCP's y axis, a width apart, and
squeeze with a force q: each presses with q while nothing else acts, and a load f along y adds f / 2 to one and takes it
from the other, so that both normal forces add up to 2 q. Then shears and normals follow from the wrench alone; free is
how the torque about the closing axis is shared out. See docs/grip-model.md.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit

from planners.geometry.pose import Array

_HALVINGS = 52
"""Of the interval in which the best share of the torque lies: down to rounding."""
_NO_NORMAL = 1e-12
"""Stands for a normal force that is none: whatever it should hold is beyond all limits [N]."""


@dataclass(frozen=True, eq=False)
class FingerForces:
    """Forces of two fingers that together exert n given wrenches; axes of the TCP."""

    forces: Array
    """(n, 2, 3) of finger 0, at -y, and of finger 1 [N]."""
    torques: Array
    """(n, 2) about the TCP's y axis [Nm]."""
    slip: Array
    """(n,) which part of their friction is used, of the finger that is nearer to slipping: the least there can be [1].
    Beyond all bounds where a finger would have to pull."""

    @property
    def normals(self) -> Array:
        """(n, 2) [N]."""
        return self.forces[:, :, 1] * (1.0, -1.0)


def squeezed(wrenches: Array, width: float, mu: float, eps: float, squeeze: float) -> FingerForces:
    """Return the forces by which two fingers that squeeze exert wrenches, as far from slipping as can be.

    Args:
        wrenches: (n, 6) that the fingers exert together, TCP axes, the torque about the TCP's origin [N, Nm].
        width: distance of both contacts along the TCP's y axis [m].
        mu: friction.
        eps: torsional friction, as a length [m].
        squeeze: as commanded [N].
    """
    forces = _spread(wrenches, width)
    normals = squeeze + 0.5 * wrenches[:, 1, None] * (1.0, -1.0)
    forces[:, :, 1] = normals * (1.0, -1.0)
    shears = np.hypot(forces[:, :, 0], forces[:, :, 2])
    twist = np.abs(wrenches[:, 4]) / eps
    strength = np.maximum(normals, _NO_NORMAL)
    first = _even_share(shears, twist, strength)
    used = np.hypot(shears, np.stack([first, twist - first], axis=1)) / (mu * strength)
    torques = np.sign(wrenches[:, 4]) * eps * first
    slip = np.where(normals.min(axis=1) < 0.0, np.inf, used.max(axis=1))
    return FingerForces(forces, np.stack([torques, wrenches[:, 4] - torques], axis=1), slip)


@njit(cache=True, nogil=True)
def least_squeeze(wrenches: Array, width: float, mu: float, eps: float) -> Array:
    """Return the least squeeze with which two fingers exert wrenches: (n,) [N]. The arguments are those of `squeezed`.

    The finger that presses against the wrench's force along y bears half of that more than the squeeze, the other half
    less; what the first must press with at least, the torque being shared out best, is the least of
    max(hypot(heavy, x), more + hypot(light, twist - x)) / mu over 0 <= x <= twist. There the first rises with x and the
    second falls: the least is at an end or where they cross.
    """
    result = np.empty(len(wrenches))
    for row, (fx, fy, fz, mx, my, mz) in enumerate(wrenches):
        # See `_spread`.
        x, z = -2.0 / width * mz, 2.0 / width * mx
        heavy = math.hypot((fx - x) / 2.0, (fz - z) / 2.0)
        light = math.hypot((fx + x) / 2.0, (fz + z) / 2.0)
        if fy < 0.0:
            heavy, light = light, heavy
        more, twist = abs(fy), abs(my) / eps
        low, high = 0.0, twist
        for _ in range(_HALVINGS):
            middle = 0.5 * (low + high)
            if math.hypot(heavy, middle) < mu * more + math.hypot(light, twist - middle):
                low = middle
            else:
                high = middle
        share = 0.5 * (low + high)
        most = max(math.hypot(heavy, share), mu * more + math.hypot(light, twist - share))
        result[row] = most / mu - 0.5 * more
    return result


def _spread(wrenches: Array, width: float) -> Array:
    """Return the forces (n, 2, 3) of both fingers that follow from wrenches alone; along y without a squeeze."""
    force, moment = wrenches[:, :3], wrenches[:, 3:]
    # moment = (w / 2) y x (f1 - f0) + (t0 + t1) y
    difference = np.zeros_like(force)
    difference[:, 0], difference[:, 2] = -2.0 / width * moment[:, 2], 2.0 / width * moment[:, 0]
    return np.stack([force - difference, force + difference], axis=1) / 2.0


def _even_share(shears: Array, twist: Array, strength: Array) -> Array:
    """Return the share x (n,) of `twist`, 0 <= x <= twist, with which the greater of both uses is least.

    They are hypot(a, x) / N and hypot(b, twist - x) / M, for shears (a, b) and strengths (N, M). The first rises with x
    and the second falls, so the least is at an end or where they are equal, which is a root of a quadratic equation.
    """
    a, b = shears.T
    N, M = strength.T
    A, B = M**2 - N**2, N**2 * twist
    C = (a * M) ** 2 - (b * N) ** 2 - B * twist
    # The stable form of the lesser positive root of A x^2 + 2 B x + C; where C > 0 the first is greater from the start.
    root = np.sqrt(np.maximum(B**2 - A * C, 0.0))
    return np.clip(-C / np.maximum(B + root, _NO_NORMAL), 0.0, twist)
