"""Closed-form inverse kinematics of arms whose axes 2, 3 and 4 are parallel, as those of Universal Robots.

Axes 1 and 2, 4 and 5, 5 and 6 meet at right angles: alpha = (±90, 0 or 180, 0 or 180, ±90, ±90, any) deg and a = (0,
a2, a3, 0, 0, any). Everything follows from the parallel axes: the wrist point is a known distance away from the plane
of the shoulder (joint 1), the tilt of the flange against that plane is joint 5, its turn joint 6, and what is left is a
planar arm of two links (joints 2, 3, 4).
"""

from __future__ import annotations

import math

from numba import njit

from planners.geometry.pose import Array, Transform
from planners.kinematics.windings import wrap

WRIST_SINGULAR = 1e-6
"""|sin q5| below which axes 4 and 6 count as parallel: q6 is then free."""

ACOS_SLACK = 1e-9
"""How far beyond 1 the cosine of a shoulder or elbow angle may come out by rounding and still be clipped."""


@njit(cache=True, nogil=True)
def same_way(alpha: float) -> float:
    """Return the cosine of an angle that is 0 or 180 deg: whether the next axis points the same way, or against it."""
    return 1.0 if abs(alpha) < 1.0 else -1.0


@njit(cache=True, nogil=True)
def clipped_acos(cosine: float) -> float:
    """Return the arc cosine, or NaN where the cosine is further than `ACOS_SLACK` beyond its range."""
    if abs(cosine) > 1.0 + ACOS_SLACK:
        return math.nan
    return math.acos(min(1.0, max(-1.0, cosine)))


@njit(cache=True, nogil=True)
def solve_parallel_axes(dh: Array, T: Transform, q6_free: float, out: Array) -> int:
    """Write all branches, as of `inverse.inverse_kinematics`.

    Args:
        dh: (6, 4) columns a, alpha, d, theta0 [m, rad].
        T: (4, 4) the flange in the base's frame, before the a and the alpha of the last row.
        q6_free: position of joint 6 to use where it is free [rad].
        out: (8, 6) of NaN, written in the rows of valid branches.

    Returns:
        The bit mask of the valid branches.
    """
    # Signs are those of a sine or cosine of each alpha, which is 1, 0 or -1.
    up1, up4, up5 = math.copysign(1.0, dh[0, 1]), math.copysign(1.0, dh[3, 1]), math.copysign(1.0, dh[4, 1])
    along3, along4 = same_way(dh[1, 1]), same_way(dh[2, 1])
    along34 = along3 * along4
    a2, a3 = dh[1, 0], dh[2, 0]
    d1, d5, d6 = dh[0, 2], up4 * along34 * dh[4, 2], dh[5, 2]
    offset = up1 * (dh[1, 2] + along3 * dh[2, 2] + along34 * dh[3, 2])
    # The wrist point: origin of frame 5, seen from the axis of joint 1.
    wx = T[0, 3] - d6 * T[0, 2]
    wy = T[1, 3] - d6 * T[1, 2]
    wz = T[2, 3] - d6 * T[2, 2] - d1
    distance = math.hypot(wx, wy)
    shoulder = clipped_acos(offset / distance) if distance > 0.0 else math.nan
    if math.isnan(shoulder):
        return 0
    bearing = math.atan2(wy, wx) + 0.5 * math.pi
    valid = 0
    for k1 in range(2):
        q1 = bearing + shoulder if k1 == 0 else bearing - shoulder
        c1, s1 = math.cos(q1), math.sin(q1)
        # The axis z3 of joint 4 is ±(s1, -c1, 0); its coordinates in the flange frame are
        # (up4 sin q5 cos q6, -up4 sin q5 sin q6, -up4 up5 cos q5).
        axis = up1 * along34
        zx = axis * (s1 * T[0, 0] - c1 * T[1, 0])
        zy = axis * (s1 * T[0, 1] - c1 * T[1, 1])
        zz = axis * (s1 * T[0, 2] - c1 * T[1, 2])
        sine = math.hypot(zx, zy)
        singular = sine < WRIST_SINGULAR
        tilt = math.atan2(0.0 if singular else sine, -up4 * up5 * zz)
        for k5 in range(2):
            sign = 1.0 if k5 == 0 else -1.0
            q5 = sign * tilt
            q6 = q6_free + dh[5, 3] if singular else math.atan2(-sign * up4 * zy, sign * up4 * zx)
            c5, s5 = math.cos(q5), math.sin(q5)
            c6, s6 = math.cos(q6), math.sin(q6)
            # The x axis of frame 4 in the flange frame is (cos q5 cos q6, -cos q5 sin q6, up5 sin q5); in frame 1 it is
            # (cos q234, sin q234, 0), with the turns of joints 3 and 4 counted about the axis of joint 2.
            xx = T[0, 0] * c5 * c6 - T[0, 1] * c5 * s6 + up5 * (T[0, 2] * s5)
            xy = T[1, 0] * c5 * c6 - T[1, 1] * c5 * s6 + up5 * (T[1, 2] * s5)
            xz = T[2, 0] * c5 * c6 - T[2, 1] * c5 * s6 + up5 * (T[2, 2] * s5)
            q234 = math.atan2(up1 * xz, c1 * xx + s1 * xy)
            # The end of the planar arm, in the x and y of frame 1: one d5 back from the wrist point.
            x = c1 * wx + s1 * wy - d5 * math.sin(q234)
            y = up1 * wz + d5 * math.cos(q234)
            elbow = clipped_acos((x * x + y * y - a2 * a2 - a3 * a3) / (2.0 * a2 * a3))
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
                row[2] = wrap(along3 * q3 - dh[2, 3])
                row[3] = wrap(along34 * (q234 - q2 - q3) - dh[3, 3])
                row[4] = wrap(q5 - dh[4, 3])
                row[5] = wrap(q6 - dh[5, 3])
                valid |= 1 << branch
    return valid


@njit(cache=True, nogil=True)
def parallel_axes_manipulability(dh: Array, q: Array) -> float:
    """Return |det J| at q (6,) [m^3]: J from joint rates to the flange's twist.

    Three parallel axes leave the product of how far the elbow is from straight, how far joint 5 is from having axes 4
    and 6 parallel, and how far the wrist is from the shoulder's axis.
    """
    along3, along4 = same_way(dh[1, 1]), same_way(dh[2, 1])
    q2, q3, q4 = q[1] + dh[1, 3], along3 * (q[2] + dh[2, 3]), along3 * along4 * (q[3] + dh[3, 3])
    d5 = math.copysign(1.0, dh[3, 1]) * along3 * along4 * dh[4, 2]
    q23 = q2 + q3
    lever = dh[1, 0] * math.cos(q2) + dh[2, 0] * math.cos(q23) + d5 * math.sin(q23 + q4)
    return abs(dh[1, 0] * dh[2, 0] * math.sin(q3) * math.sin(q[4] + dh[4, 3]) * lever)
