"""What two fingers must exert on the tool between them, with the least squeeze: a cone program in nearly closed form.

A finger is a soft finger (paper B, 5c): its shear s and its torque t about the normal need
`sqrt(|s|^2 + (t / eps)^2) <= mu * normal`. Two of them face one another along the TCP's y axis, a width apart. Then
both shears and the difference of both normals follow from the wrench alone; free are the squeeze, and how the torque
about the closing axis is shared out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planners.geometry.pose import Array

_HALVINGS = 52
"""Of the interval in which the best share of the torque lies: down to rounding."""


@dataclass(frozen=True, eq=False)
class FingerForces:
    """Forces of two fingers that together exert n given wrenches; axes of the TCP."""

    forces: Array
    """(n, 2, 3) of finger 0, at -y, and of finger 1 [N]."""
    torques: Array
    """(n, 2) about the TCP's y axis [Nm]."""
    normal: Array
    """(n,) the greater of both normal forces: the least there can be [N]."""


def least_squeeze(wrenches: Array, width: float, mu: float, eps: float) -> FingerForces:
    """Return the forces with the least greatest normal by which two fingers exert wrenches.

    Args:
        wrenches: (n, 6) that the fingers exert together, TCP axes, the torque about the TCP's origin [N, Nm].
        width: distance of both contacts along the TCP's y axis [m].
        mu: friction.
        eps: torsional friction, as a length [m].
    """
    force, moment = wrenches[:, :3], wrenches[:, 3:]
    # moment = (w / 2) y x (f1 - f0) + (t0 + t1) y
    difference = np.zeros_like(force)
    difference[:, 0], difference[:, 2] = -2.0 / width * moment[:, 2], 2.0 / width * moment[:, 0]
    forces = np.stack([force - difference, force + difference], axis=1) / 2.0
    shears = np.hypot(forces[:, :, 0], forces[:, :, 2])
    # The finger that presses against the wrench's force along y bears that much more than the other.
    heavy = (force[:, 1] < 0.0).astype(int)
    rows = np.arange(len(wrenches))
    more, twist = np.abs(force[:, 1]), np.abs(moment[:, 1]) / eps
    share, bound = _least_bound(shears[rows, heavy], shears[rows, 1 - heavy], mu * more, twist)
    normals, torques = np.empty((len(wrenches), 2)), np.empty((len(wrenches), 2))
    normals[rows, heavy], normals[rows, 1 - heavy] = bound / mu, bound / mu - more
    torques[rows, heavy] = np.sign(moment[:, 1]) * eps * share
    torques[rows, 1 - heavy] = moment[:, 1] - torques[rows, heavy]
    forces[:, 0, 1], forces[:, 1, 1] = normals[:, 0], -normals[:, 1]
    return FingerForces(forces, torques, bound / mu)


def scaled(exerted: FingerForces, share: Array) -> FingerForces:
    """Return what the fingers exert for shares (n,) of their wrenches: forces grow with the load."""
    return FingerForces(exerted.forces * share[:, None, None], exerted.torques * share[:, None], exerted.normal * share)


def _least_bound(heavy: Array, light: Array, more: Array, twist: Array) -> tuple[Array, Array]:
    """Minimise max(hypot(heavy, x), more + hypot(light, twist - x)) over 0 <= x <= twist: x and the least value.

    The first rises with x and the second falls, so the least lies at an end or where they cross.
    """
    low, high = np.zeros_like(twist), twist.copy()
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        below = np.hypot(heavy, middle) < more + np.hypot(light, twist - middle)
        low, high = np.where(below, middle, low), np.where(below, high, middle)
    x = 0.5 * (low + high)
    return x, np.maximum(np.hypot(heavy, x), more + np.hypot(light, twist - x))
