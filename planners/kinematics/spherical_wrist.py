"""Closed-form inverse kinematics of industrial arms: axes 2 and 3 parallel, axes 4, 5 and 6 through one point.

Axis 2 is at right angles to axis 1, axis 4 to axis 3, axis 5 to axes 4 and 6: alpha = (±90, 0 or 180, ±90, ±90, ±90,
any) deg, a = (a1, a2, a3, 0, 0, any), d = (d1, d2, d3, d4, 0, d6). The point where the wrist's axes meet depends on
joints 1 to 3 alone: joint 1 turns the plane of the arm to it, and joints 2 and 3 are a planar arm whose second link
goes from axis 3 to that point. What they leave of the flange's orientation are the three Euler angles of the wrist
(Pieper, "The kinematics of manipulators under computer control", 1968).
"""

from __future__ import annotations

import math

from numba import njit

from planners.geometry.pose import Array, Transform
from planners.kinematics.parallel_axes import ACOS_SLACK, WRIST_SINGULAR, clipped_acos, same_way
from planners.kinematics.windings import wrap


@njit(cache=True, nogil=True)
def solve_spherical_wrist(dh: Array, T: Transform, q6_free: float, out: Array) -> int:
    """Write all branches, as of `inverse.inverse_kinematics`; arguments as of `parallel_axes.solve_parallel_axes`.

    Where the wrist is on the axis of joint 1, which then is free, joint 1 stands as for a wrist ahead of it.
    """
    # Signs are those of a sine or cosine of each alpha, which is 1, 0 or -1.
    up1, up3 = math.copysign(1.0, dh[0, 1]), math.copysign(1.0, dh[2, 1])
    up4, up5 = math.copysign(1.0, dh[3, 1]), math.copysign(1.0, dh[4, 1])
    along3 = same_way(dh[1, 1])
    a1, a2, d1, d6 = dh[0, 0], dh[1, 0], dh[0, 2], dh[5, 2]
    # The wrist point seen from axis 3, in the plane of the arm: its distance, and its direction at q3 = 0.
    reach, lean = math.hypot(dh[2, 0], dh[3, 2]), math.atan2(-along3 * up3 * dh[3, 2], dh[2, 0])
    # How far that plane passes by the axis of joint 1.
    offset = -up1 * (dh[1, 2] + along3 * dh[2, 2])
    wx = T[0, 3] - d6 * T[0, 2]
    wy = T[1, 3] - d6 * T[1, 2]
    y = up1 * (T[2, 3] - d6 * T[2, 2] - d1)
    distance = math.hypot(wx, wy)
    if distance < abs(offset) * (1.0 - ACOS_SLACK):
        return 0
    ahead = math.sqrt(max(0.0, (distance - abs(offset)) * (distance + abs(offset))))
    bearing = math.atan2(wy, wx)
    valid = 0
    for k1 in range(2):
        forward = ahead if k1 == 0 else -ahead
        q1 = bearing - math.atan2(offset, forward)
        c1, s1 = math.cos(q1), math.sin(q1)
        x = forward - a1
        elbow = clipped_acos((x * x + y * y - a2 * a2 - reach * reach) / (2.0 * a2 * reach))
        if math.isnan(elbow):
            continue
        for k3 in range(2):
            bend = elbow if k3 == 0 else -elbow
            ux, uy = a2 + reach * math.cos(bend), reach * math.sin(bend)
            q2 = math.atan2(ux * y - uy * x, ux * x + uy * y)
            q3 = along3 * (bend - lean)
            # Axes of frame 3 in the base: x3 and z3 lie in the plane of the arm, at q23 and a right angle further.
            q23 = q2 + bend - lean
            c23, s23 = math.cos(q23), math.sin(q23)
            lift = up1 * s23
            # The flange's axes in frame 3: x along x3, z along z3, y along what completes them.
            side = along3 * up3
            zx = c1 * c23 * T[0, 2] + s1 * c23 * T[1, 2] + lift * T[2, 2]
            zy = along3 * up1 * up3 * (s1 * T[0, 2] - c1 * T[1, 2])
            zz = side * (c1 * s23 * T[0, 2] + s1 * s23 * T[1, 2] - up1 * c23 * T[2, 2])
            xz = side * (c1 * s23 * T[0, 0] + s1 * s23 * T[1, 0] - up1 * c23 * T[2, 0])
            yz = side * (c1 * s23 * T[0, 1] + s1 * s23 * T[1, 1] - up1 * c23 * T[2, 1])
            sine = math.hypot(zx, zy)
            singular = sine < WRIST_SINGULAR
            tilt = math.atan2(0.0 if singular else sine, -up4 * up5 * zz)
            for k5 in range(2):
                sign = 1.0 if k5 == 0 else -1.0
                q5 = sign * tilt
                if singular:
                    # Then x4 is the flange's x axis turned back by q6, and x3 turned by q4 where q5 is 0.
                    q6 = q6_free + dh[5, 3]
                    c6, s6 = math.cos(q6), math.sin(q6)
                    tx, ty = c6 * T[0, 0] - s6 * T[0, 1], c6 * T[1, 0] - s6 * T[1, 1]
                    tz = c6 * T[2, 0] - s6 * T[2, 1]
                    flip = 1.0 if tilt < 1.0 else -1.0
                    across = along3 * up1 * up3 * (s1 * tx - c1 * ty)
                    q4 = math.atan2(flip * across, flip * (c1 * c23 * tx + s1 * c23 * ty + lift * tz))
                else:
                    # z6 in frame 3 is (up5 sin q5 cos q4, up5 sin q5 sin q4, -up4 up5 cos q5), and z3 in the flange
                    # frame (up4 sin q5 cos q6, -up4 sin q5 sin q6, -up4 up5 cos q5).
                    q4 = math.atan2(sign * up5 * zy, sign * up5 * zx)
                    q6 = math.atan2(-sign * up4 * yz, sign * up4 * xz)
                branch = 4 * k1 + 2 * k5 + k3
                row = out[branch]
                row[0] = wrap(q1 - dh[0, 3])
                row[1] = wrap(q2 - dh[1, 3])
                row[2] = wrap(q3 - dh[2, 3])
                row[3] = wrap(q4 - dh[3, 3])
                row[4] = wrap(q5 - dh[4, 3])
                row[5] = wrap(q6 - dh[5, 3])
                valid |= 1 << branch
    return valid


@njit(cache=True, nogil=True)
def spherical_wrist_manipulability(dh: Array, q: Array) -> float:
    """Return |det J| at q (6,) [m^3]: J from joint rates to the flange's twist.

    The product of how far the elbow is from straight, how far joint 5 is from having axes 4 and 6 parallel, and how far
    the wrist is from the shoulder's axis.
    """
    along3, up3 = same_way(dh[1, 1]), math.copysign(1.0, dh[2, 1])
    reach, lean = math.hypot(dh[2, 0], dh[3, 2]), math.atan2(-along3 * up3 * dh[3, 2], dh[2, 0])
    q2, bend = q[1] + dh[1, 3], along3 * (q[2] + dh[2, 3]) + lean
    lever = dh[0, 0] + dh[1, 0] * math.cos(q2) + reach * math.cos(q2 + bend)
    return abs(dh[1, 0] * reach * math.sin(bend) * math.sin(q[4] + dh[4, 3]) * lever)
