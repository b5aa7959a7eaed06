"""Forward kinematics and the Jacobian of one arm, from its Denavit-Hartenberg table.

`T_world_flange = T_world_base @ prod_i Rz(q_i + theta0_i) Tz(d_i) Tx(a_i) Rx(alpha_i)`; frame i is the frame after
i joints, so that frame 0 is the base and frame 6 the flange. A table has the columns a, alpha, d, theta0 [m, rad].
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from planners.geometry.pose import Array, Transform


@njit(cache=True, nogil=True)
def link_frames(dh: Array, T_world_base: Transform, q: Array, out: Array) -> None:
    """Write `T_world_i` of all frames of an arm.

    Args:
        dh: (6, 4), see the module.
        T_world_base: (4, 4).
        q: (6,) joint positions in the controller's convention [rad].
        out: (7, 4, 4), written: frame 0 (base) to frame 6 (flange).
    """
    out[0] = T_world_base
    for i in range(6):
        a, alpha, d = dh[i, 0], dh[i, 1], dh[i, 2]
        theta = q[i] + dh[i, 3]
        ct, st = math.cos(theta), math.sin(theta)
        ca, sa = math.cos(alpha), math.sin(alpha)
        for row in range(3):
            x, y, z = out[i, row, 0], out[i, row, 1], out[i, row, 2]
            # The new x axis, and the direction that the new y and z are turned out of by alpha.
            along = x * ct + y * st
            across = y * ct - x * st
            out[i + 1, row, 0] = along
            out[i + 1, row, 1] = across * ca + z * sa
            out[i + 1, row, 2] = z * ca - across * sa
            out[i + 1, row, 3] = out[i, row, 3] + a * along + d * z
        out[i + 1, 3, 0] = 0.0
        out[i + 1, 3, 1] = 0.0
        out[i + 1, 3, 2] = 0.0
        out[i + 1, 3, 3] = 1.0


@njit(cache=True, nogil=True)
def flange_pose(dh: Array, T_world_base: Transform, q: Array) -> Transform:
    """Return `T_world_flange`, (4, 4), at the joint positions `q` (6,) [rad]; `dh` as in `link_frames`."""
    frames = np.empty((7, 4, 4))
    link_frames(dh, T_world_base, q, frames)
    return frames[6].copy()


def flange_pose_of_plan(dh: Array, T_world_base: Transform, q: Array) -> Transform:
    """Return `flange_pose` of arrays as a plan holds them, which must not be written to.

    Compiled code takes such an array for one of another type, for which it would first be compiled: some seconds.
    """
    own = [np.array(array, dtype=float, order="C") for array in (dh, T_world_base, q)]
    return flange_pose(*own)


@njit(cache=True, nogil=True)
def jacobian(dh: Array, T_world_base: Transform, q: Array, point_world: Array) -> Array:
    """Return J (6, 6) with `[v; w] = J @ dq` in world axes.

    v is the velocity [m/s] of the point of the flange that is at `point_world` (3,) now, w the flange's angular
    velocity [rad/s]: column i is `[z_i x (p - o_i); z_i]` with the axis z and origin o of frame i - 1.
    """
    frames = np.empty((7, 4, 4))
    link_frames(dh, T_world_base, q, frames)
    J = np.empty((6, 6))
    for i in range(6):
        zx, zy, zz = frames[i, 0, 2], frames[i, 1, 2], frames[i, 2, 2]
        rx = point_world[0] - frames[i, 0, 3]
        ry = point_world[1] - frames[i, 1, 3]
        rz = point_world[2] - frames[i, 2, 3]
        J[0, i] = zy * rz - zz * ry
        J[1, i] = zz * rx - zx * rz
        J[2, i] = zx * ry - zy * rx
        J[3, i] = zx
        J[4, i] = zy
        J[5, i] = zz
    return J


@njit(cache=True, nogil=True)
def frame_motion(
    dh: Array, T_world_base: Transform, T_flange_frame: Transform, q: Array, velocities: Array
) -> tuple[Transform, Array]:
    """Return the pose `T_world_frame` of a frame on the flange, and its (6,) twist about its own origin, world axes.

    Args:
        dh: (6, 4), see the module.
        T_world_base: (4, 4).
        T_flange_frame: (4, 4).
        q: (6,) joint positions [rad].
        velocities: (6,) of the joints [rad/s].
    """
    frames = np.empty((7, 4, 4))
    link_frames(dh, T_world_base, q, frames)
    flange, T, twist = frames[6], np.zeros((4, 4)), np.zeros(6)
    T[3, 3] = 1.0
    for i in range(3):
        for j in range(4):
            T[i, j] = flange[i, 0] * T_flange_frame[0, j] + flange[i, 1] * T_flange_frame[1, j]
            T[i, j] += flange[i, 2] * T_flange_frame[2, j]
        T[i, 3] += flange[i, 3]
    for i in range(6):
        zx, zy, zz = frames[i, 0, 2], frames[i, 1, 2], frames[i, 2, 2]
        rx, ry, rz = T[0, 3] - frames[i, 0, 3], T[1, 3] - frames[i, 1, 3], T[2, 3] - frames[i, 2, 3]
        speed = velocities[i]
        twist[0] += speed * (zy * rz - zz * ry)
        twist[1] += speed * (zz * rx - zx * rz)
        twist[2] += speed * (zx * ry - zy * rx)
        twist[3] += speed * zx
        twist[4] += speed * zy
        twist[5] += speed * zz
    return T, twist


@njit(cache=True, nogil=True)
def flange_poses(dh: Array, T_world_base: Transform, Q: Array) -> Array:
    """Return `T_world_flange` (n, 4, 4) at the joint positions `Q` (n, 6) [rad]; `dh` as in `link_frames`."""
    frames = np.empty((7, 4, 4))
    result = np.empty((Q.shape[0], 4, 4))
    for k in range(Q.shape[0]):
        link_frames(dh, T_world_base, Q[k], frames)
        result[k] = frames[6]
    return result
