"""Closed-form inverse kinematics of six-axis arms: all eight branches.

Two kinds of arms have one: those with three parallel axes, and those with a spherical wrist. Which of them an arm is,
its Denavit-Hartenberg table says; `arm_kind` tells why another is neither.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from planners.geometry.pose import Array, Transform
from planners.kinematics.parallel_axes import parallel_axes_manipulability, solve_parallel_axes
from planners.kinematics.spherical_wrist import solve_spherical_wrist, spherical_wrist_manipulability
from planners.kinematics.windings import wrap

BRANCHES = 8
"""Branch `4 shoulder + 2 wrist + elbow`: each bit says which sign its square root takes (0 plus, 1 minus)."""


@njit(cache=True, nogil=True)
def inverse_kinematics(dh: Array, T_base_flange: Transform, q6_free: float, out: Array) -> int:
    """Find the joint positions of all branches that put the flange at a pose.

    A branch is a continuous function of the pose (up to whole turns) as long as it stays valid and away from
    singularities, where branches meet: there two of them are equal. Where axes 4 and 6 are parallel, within
    `WRIST_SINGULAR`, joint 6 is `q6_free` and the pose is met to that angle.

    Args:
        dh: (6, 4) columns a, alpha, d, theta0 of an arm of which `arm_kind` knows the kind [m, rad].
        T_base_flange: (4, 4).
        q6_free: position of joint 6 to use where it is free [rad].
        out: (8, 6), written: joint positions in (-pi, pi] [rad]; NaN in the rows of branches without a solution.

    Returns:
        The bit mask of the valid branches: bit k for row k. 0 when the pose is out of reach.
    """
    out[:] = math.nan
    T = T_base_flange
    if dh[5, 0] != 0.0 or dh[5, 1] != 0.0:
        T = _before_last_shift(dh[5, 0], dh[5, 1], T_base_flange)
    if _has_spherical_wrist(dh):
        return solve_spherical_wrist(dh, T, q6_free, out)
    return solve_parallel_axes(dh, T, q6_free, out)


@njit(cache=True, nogil=True)
def manipulability(dh: Array, q: Array) -> float:
    """Return |det J| at q (6,) [m^3]: J from joint rates to the flange's twist; `dh` as of `inverse_kinematics`."""
    if _has_spherical_wrist(dh):
        return spherical_wrist_manipulability(dh, q)
    return parallel_axes_manipulability(dh, q)


@njit(cache=True, nogil=True)
def _has_spherical_wrist(dh: Array) -> bool:
    """Tell the two kinds apart: axis 4 is at a right angle to axis 3, or parallel to it."""
    return 1.0 < abs(dh[2, 1]) < 2.0


@njit(cache=True, nogil=True)
def _before_last_shift(a: float, alpha: float, T: Transform) -> Transform:
    """Return `T Rx(-alpha) Tx(-a)`: the flange before the a and the alpha of the last row."""
    result, c, s = T.copy(), math.cos(alpha), math.sin(alpha)
    for i in range(3):
        result[i, 1] = T[i, 1] * c - T[i, 2] * s
        result[i, 2] = T[i, 1] * s + T[i, 2] * c
        result[i, 3] = T[i, 3] - a * T[i, 0]
    return result


_TURN = 2.0 * math.pi


@njit(cache=True, nogil=True)
def multiply(A: Transform, B: Transform, out: Transform) -> None:
    """Compose two rigid transforms without leaving the compiled code."""
    for i in range(3):
        for j in range(4):
            value = A[i, 0] * B[0, j] + A[i, 1] * B[1, j] + A[i, 2] * B[2, j]
            out[i, j] = value + A[i, 3] if j == 3 else value
    out[3, 0], out[3, 1], out[3, 2], out[3, 3] = 0.0, 0.0, 0.0, 1.0


@njit(cache=True, nogil=True)
def within_limits(q: Array, lo: Array, hi: Array) -> bool:
    """Tell whether the positions (6,), each in (-pi, pi], are within limits, possibly after a whole turn [rad]."""
    for i in range(6):
        if not (lo[i] <= q[i] <= hi[i] or lo[i] <= q[i] + _TURN <= hi[i] or lo[i] <= q[i] - _TURN <= hi[i]):
            return False
    return True


@njit(cache=True, nogil=True)
def follow_branch(dh: Array, T_base_world: Transform, T_world_flanges: Array, branch: int, reference: Array) -> Array:
    """Return the (n, 6) joint positions of one branch with the flange at (n, 4, 4) [rad].

    Whole turns are chosen so that each row is nearest to the row before or, unless it is empty, to the same row of
    `reference` (n, 6). NaN where the branch does not reach; joint limits are not looked at.
    """
    count = T_world_flanges.shape[0]
    result = np.empty((count, 6))
    T_base_flange, solutions = np.empty((4, 4)), np.empty((8, 6))
    for p in range(count):
        multiply(T_base_world, T_world_flanges[p], T_base_flange)
        inverse_kinematics(dh, T_base_flange, 0.0, solutions)
        for i in range(6):
            value = solutions[branch, i]
            if reference.shape[0] > 0:
                value = reference[p, i] + wrap(value - reference[p, i])
            elif p > 0:
                value = result[p - 1, i] + wrap(value - result[p - 1, i])
            result[p, i] = value
    return result
