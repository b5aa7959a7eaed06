"""What the motors of one arm must exert: arm and hand against gravity, their motion, and what the hand exerts.

Links and hand are point masses at their centres of mass, so that what turning them about themselves takes is left out,
as is what the motors' rotors take: the one is small, the other is not published. At rest nothing is left out.

Signs: a torque is positive about the joint's axis. A wrench is what the hand exerts on the body it holds, so that the
body exerts the opposite on the hand; at rest `tau = g(q) + J^T w`, with the gravity torques g and the Jacobian J of the
point that w is about.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from planners.geometry.pose import Array, Transform
from planners.kinematics.forward import link_frames


class WeighedArm(NamedTuple):
    """One arm with its hand, for compiled code."""

    dh: Array
    """(6, 4), see `planners.kinematics.forward`."""
    T_world_base: Transform
    masses: Array
    """(m, 4) mass [kg] and centre of mass [m] of link i in frame i + 1, of the hand and of what is fixed to it in
    frame 6; m is 7 where nothing is."""
    gravity: Array
    """(3,) in the world [m/s^2]."""


@njit(cache=True, nogil=True)
def joint_torques(arm: WeighedArm, Q: Array, V: Array, A: Array, wrenches: Array, points: Array) -> Array:
    """Return the torques of all joints at n samples: (n, 6) [Nm].

    Args:
        arm: with its hand.
        Q: (n, 6) joint positions [rad].
        V: (n, 6) velocities [rad/s].
        A: (n, 6) accelerations [rad/s^2].
        wrenches: (n, 6) that the hand exerts on what it holds, world axes, about `points` [N, Nm].
        points: (n, 3) in the world [m].
    """
    frames, pulls = np.empty((7, 4, 4)), np.empty((arm.masses.shape[0], 3))
    result = np.empty((Q.shape[0], 6))
    for k in range(Q.shape[0]):
        link_frames(arm.dh, arm.T_world_base, Q[k], frames)
        _accelerate(frames, arm.masses, V[k], A[k], pulls)
        pulls -= arm.gravity
        _sum_up(frames, arm.masses, pulls, wrenches[k], points[k], result[k])
    return result


@njit(cache=True, nogil=True)
def torques_at_rest(arm: WeighedArm, frames: Array, wrench: Array, point: Array, out: Array) -> None:
    """Write the torques (6,) of an arm that does not move, and whose frames (7, 4, 4) in the world are known [Nm].

    The wrench (6,) is what the hand exerts, about the point (3,), as of `joint_torques`.
    """
    pulls = np.empty((arm.masses.shape[0], 3))
    pulls[:] = -arm.gravity
    _sum_up(frames, arm.masses, pulls, wrench, point, out)


@njit(cache=True, nogil=True)
def _sum_up(frames, masses, pulls, wrench, point, out):
    """Write the torques where the acceleration of each mass, less gravity, is `pulls` (m, 3), world axes [m/s^2]."""
    # What is carried beyond a joint, summed from the hand in; moments are about the world's origin.
    fx, fy, fz = wrench[0], wrench[1], wrench[2]
    mx, my, mz = _cross(point[0], point[1], point[2], fx, fy, fz)
    mx, my, mz = mx + wrench[3], my + wrench[4], mz + wrench[5]
    for i in range(masses.shape[0] - 1, -1, -1):
        mass, frame = masses[i, 0], frames[min(i + 1, 6)]
        px, py, pz = mass * pulls[i, 0], mass * pulls[i, 1], mass * pulls[i, 2]
        cx, cy, cz = _lever(frame, masses[i])
        tx, ty, tz = _cross(frame[0, 3] + cx, frame[1, 3] + cy, frame[2, 3] + cz, px, py, pz)
        fx, fy, fz = fx + px, fy + py, fz + pz
        mx, my, mz = mx + tx, my + ty, mz + tz
        if i < 6:
            # Joint i turns frame i + 1 about the z axis of frame i.
            frame = frames[i]
            tx, ty, tz = _cross(frame[0, 3], frame[1, 3], frame[2, 3], fx, fy, fz)
            out[i] = frame[0, 2] * (mx - tx) + frame[1, 2] * (my - ty) + frame[2, 2] * (mz - tz)


@njit(cache=True, nogil=True)
def _accelerate(frames, masses, v, a, out):
    """Write the acceleration (m, 3) of each mass, joint by joint from the base out."""
    wx = wy = wz = 0.0  # angular velocity of the link
    ax = ay = az = 0.0  # its angular acceleration
    ox = oy = oz = 0.0  # acceleration of the origin of its frame
    for i in range(masses.shape[0]):
        if i < 6:
            before, after = frames[i], frames[i + 1]
            zx, zy, zz = before[0, 2], before[1, 2], before[2, 2]
            tx, ty, tz = _cross(wx, wy, wz, zx, zy, zz)
            ax, ay, az = ax + a[i] * zx + v[i] * tx, ay + a[i] * zy + v[i] * ty, az + a[i] * zz + v[i] * tz
            wx, wy, wz = wx + v[i] * zx, wy + v[i] * zy, wz + v[i] * zz
            rx, ry, rz = after[0, 3] - before[0, 3], after[1, 3] - before[1, 3], after[2, 3] - before[2, 3]
            sx, sy, sz = _swung(wx, wy, wz, ax, ay, az, rx, ry, rz)
            ox, oy, oz = ox + sx, oy + sy, oz + sz
        rx, ry, rz = _lever(frames[min(i + 1, 6)], masses[i])
        sx, sy, sz = _swung(wx, wy, wz, ax, ay, az, rx, ry, rz)
        out[i, 0], out[i, 1], out[i, 2] = ox + sx, oy + sy, oz + sz


@njit(cache=True, nogil=True)
def _lever(frame, row):
    """Return the way from a frame's origin to a row's centre of mass, in world axes [m]."""
    x, y, z = row[1], row[2], row[3]
    return (
        frame[0, 0] * x + frame[0, 1] * y + frame[0, 2] * z,
        frame[1, 0] * x + frame[1, 1] * y + frame[1, 2] * z,
        frame[2, 0] * x + frame[2, 1] * y + frame[2, 2] * z,
    )


@njit(cache=True, nogil=True)
def _swung(wx, wy, wz, ax, ay, az, rx, ry, rz):  # noqa: PLR0913 - three vectors, without an allocation
    """Return the acceleration of the end of a rigid lever r against its beginning: a x r + w x (w x r)."""
    tx, ty, tz = _cross(wx, wy, wz, rx, ry, rz)
    ux, uy, uz = _cross(wx, wy, wz, tx, ty, tz)
    tx, ty, tz = _cross(ax, ay, az, rx, ry, rz)
    return tx + ux, ty + uy, tz + uz


@njit(cache=True, nogil=True)
def _cross(ax, ay, az, bx, by, bz):
    return ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
