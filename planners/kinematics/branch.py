"""One branch of the inverse kinematics along a motion of the flange (compiled)."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from planners.geometry.pose import Array, Transform
from planners.kinematics.inverse import inverse_kinematics
from planners.kinematics.windings import wrap

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
