"""Closed-form inverse kinematics of an arm of the UR family: all eight branches.

The family has the Denavit-Hartenberg angles alpha = (pi/2, 0, 0, pi/2, -pi/2, 0) and the lengths d1, a2, a3, d4, d5,
d6 (d2 and d3 only add to d4). Axes 2, 3 and 4 are parallel, and everything follows from that: the wrist point is d4
away from the plane of the shoulder (joint 1), the tilt of the flange against that plane is joint 5, its turn joint 6,
and what is left is a planar arm of two links (joints 2, 3, 4).
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from planners.geometry.pose import Array, Transform
from planners.kinematics.windings import wrap

BRANCHES = 8
"""Branch `4 shoulder + 2 wrist + elbow`: each bit says which sign its square root takes (0 plus, 1 minus)."""

WRIST_SINGULAR = 1e-6
"""|sin q5| below which axes 4 and 6 count as parallel: q6 is then free."""

ACOS_SLACK = 1e-9
"""How far beyond 1 the cosine of a shoulder or elbow angle may come out by rounding and still be clipped."""

_UR_ALPHA = (math.pi / 2, 0.0, 0.0, math.pi / 2, -math.pi / 2, 0.0)


def is_ur_type(dh: Array) -> bool:
    """Tell whether the (6, 4) table `dh` belongs to an arm that `inverse_kinematics` can solve."""
    a = dh[:, 0]
    return bool(
        np.allclose(dh[:, 1], _UR_ALPHA, atol=1e-12) and np.all(a[[0, 3, 4, 5]] == 0.0) and a[1] != 0.0 and a[2] != 0.0
    )


@njit(cache=True, nogil=True)
def _clipped_acos(cosine: float) -> float:
    """Return the arc cosine, or NaN where the cosine is further than `ACOS_SLACK` beyond its range."""
    if abs(cosine) > 1.0 + ACOS_SLACK:
        return math.nan
    return math.acos(min(1.0, max(-1.0, cosine)))


@njit(cache=True, nogil=True)
def inverse_kinematics(dh: Array, T_base_flange: Transform, q6_free: float, out: Array) -> int:
    """Find the joint positions of all branches that put the flange at a pose.

    A branch is a continuous function of the pose (up to whole turns) as long as it stays valid and away from
    singularities, where branches meet: there two of them are equal. Where axes 4 and 6 are parallel, within
    `WRIST_SINGULAR`, joint 6 is `q6_free` and the pose is met to that angle.

    Args:
        dh: (6, 4) columns a, alpha, d, theta0 of an arm for which `is_ur_type` holds [m, rad].
        T_base_flange: (4, 4).
        q6_free: position of joint 6 to use where it is free [rad].
        out: (8, 6), written: joint positions in (-pi, pi] [rad]; NaN in the rows of branches without a solution.

    Returns:
        The bit mask of the valid branches: bit k for row k. 0 when the pose is out of reach.
    """
    a2, a3 = dh[1, 0], dh[2, 0]
    d1, d5, d6 = dh[0, 2], dh[4, 2], dh[5, 2]
    offset = dh[1, 2] + dh[2, 2] + dh[3, 2]
    T = T_base_flange
    out[:] = math.nan
    # The wrist point: origin of frame 5, seen from the axis of joint 1.
    wx = T[0, 3] - d6 * T[0, 2]
    wy = T[1, 3] - d6 * T[1, 2]
    wz = T[2, 3] - d6 * T[2, 2] - d1
    distance = math.hypot(wx, wy)
    shoulder = _clipped_acos(offset / distance) if distance > 0.0 else math.nan
    if math.isnan(shoulder):
        return 0
    bearing = math.atan2(wy, wx) + 0.5 * math.pi
    valid = 0
    for k1 in range(2):
        q1 = bearing + shoulder if k1 == 0 else bearing - shoulder
        c1, s1 = math.cos(q1), math.sin(q1)
        # The axis z1 of joints 2, 3, 4 is (s1, -c1, 0); its coordinates in the flange frame are
        # (sin q5 cos q6, -sin q5 sin q6, cos q5).
        zx = s1 * T[0, 0] - c1 * T[1, 0]
        zy = s1 * T[0, 1] - c1 * T[1, 1]
        zz = s1 * T[0, 2] - c1 * T[1, 2]
        sine = math.hypot(zx, zy)
        singular = sine < WRIST_SINGULAR
        tilt = math.atan2(0.0 if singular else sine, zz)
        for k5 in range(2):
            sign = 1.0 if k5 == 0 else -1.0
            q5 = sign * tilt
            q6 = q6_free + dh[5, 3] if singular else math.atan2(-sign * zy, sign * zx)
            c5, s5 = math.cos(q5), math.sin(q5)
            c6, s6 = math.cos(q6), math.sin(q6)
            # The x axis of frame 4 in the flange frame is (cos q5 cos q6, -cos q5 sin q6, -sin q5); in frame 1 it is
            # (cos q234, sin q234, 0).
            xx = T[0, 0] * c5 * c6 - T[0, 1] * c5 * s6 - T[0, 2] * s5
            xy = T[1, 0] * c5 * c6 - T[1, 1] * c5 * s6 - T[1, 2] * s5
            xz = T[2, 0] * c5 * c6 - T[2, 1] * c5 * s6 - T[2, 2] * s5
            q234 = math.atan2(xz, c1 * xx + s1 * xy)
            # The end of the planar arm, in the x and y of frame 1: one d5 back from the wrist point.
            x = c1 * wx + s1 * wy - d5 * math.sin(q234)
            y = wz + d5 * math.cos(q234)
            elbow = _clipped_acos((x * x + y * y - a2 * a2 - a3 * a3) / (2.0 * a2 * a3))
            if math.isnan(elbow):
                continue
            for k3 in range(2):
                q3 = elbow if k3 == 0 else -elbow
                ux, uy = a2 + a3 * math.cos(q3), a3 * math.sin(q3)
                q2 = math.atan2(ux * y - uy * x, ux * x + uy * y)
                branch = 4 * k1 + 2 * k5 + k3
                row = out[branch]
                row[0] = wrap(q1 - dh[0, 3])
                row[1] = wrap(q2 - dh[1, 3])
                row[2] = wrap(q3 - dh[2, 3])
                row[3] = wrap(q234 - q2 - q3 - dh[3, 3])
                row[4] = wrap(q5 - dh[4, 3])
                row[5] = wrap(q6 - dh[5, 3])
                valid |= 1 << branch
    return valid


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
