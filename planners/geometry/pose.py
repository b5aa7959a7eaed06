"""Rigid transforms as 4x4 homogeneous arrays.

A transform is named `T_a_b`: it takes homogeneous coordinates in frame b to frame a, so that inner names
cancel: `T_world_tool = T_world_object @ T_object_tool`. Lengths are in metres. Documents carry the same
transform as `[x, y, z, w, x, y, z]`: position, then a unit quaternion with the scalar first.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Transform = NDArray[np.float64]
"""A 4x4 homogeneous rigid transform."""


def transform(rotation: Array | None = None, position: Sequence[float] | Array | None = None) -> Transform:
    """Assemble `T_a_b` from the (3, 3) rotation and the origin of b in a [m]; either may be left out."""
    T = np.eye(4)
    if rotation is not None:
        T[:3, :3] = rotation
    if position is not None:
        T[:3, 3] = position
    return T


def inverse(T_a_b: Transform) -> Transform:
    """Return `T_b_a`."""
    R = T_a_b[:3, :3].T
    return transform(R, -R @ T_a_b[:3, 3])


def from_pose7(pose: Sequence[float] | Array) -> Transform:
    """Read `[x, y, z, w, x, y, z]`; the quaternion is normalised."""
    values = np.asarray(pose, dtype=float)
    return _transforms(values[None, :3], (values[3:] / np.linalg.norm(values[3:]))[None])[0]


def from_pose7s(poses: Array) -> Array:
    """Read many poses (n, 7) as `from_pose7` reads one: (n, 4, 4)."""
    return _transforms(poses[:, :3], poses[:, 3:] / np.linalg.norm(poses[:, 3:], axis=1, keepdims=True))


def _transforms(positions: Array, quaternions: Array) -> Array:
    """Assemble (n, 4, 4) from positions (n, 3) and unit quaternions (n, 4)."""
    w, x, y, z = quaternions.T
    transforms = np.tile(np.eye(4), (len(positions), 1, 1))
    transforms[:, 0, :3] = np.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)], axis=1)
    transforms[:, 1, :3] = np.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)], axis=1)
    transforms[:, 2, :3] = np.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], axis=1)
    transforms[:, :3, 3] = positions
    return transforms


def to_pose7(T: Transform) -> list[float]:
    """Write `[x, y, z, w, x, y, z]` with a unit quaternion whose scalar part is not negative."""
    return pose_row(T).tolist()


def pose_row(T: Transform) -> Array:
    """Return a transform as `to_pose7` writes it, as an array (7,)."""
    return to_pose7s(T[None])[0]


def to_pose7s(transforms: Array) -> Array:
    """Write many transforms (n, 4, 4) as `to_pose7` writes one: (n, 7)."""
    R = transforms[:, :3, :3]
    # Every row is a multiple of the quaternion. The one with the largest of the four squared components divides by
    # nothing small.
    rows = np.empty((len(transforms), 4, 4))
    for i, (x, y, z) in enumerate(((1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1))):
        rows[:, i, i] = 1 + x * R[:, 0, 0] + y * R[:, 1, 1] + z * R[:, 2, 2]
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        rows[:, 0, 1 + i] = rows[:, 1 + i, 0] = R[:, k, j] - R[:, j, k]
        rows[:, 1 + j, 1 + k] = rows[:, 1 + k, 1 + j] = R[:, j, k] + R[:, k, j]
    largest = np.argmax(rows[:, range(4), range(4)], axis=1)
    quaternions = rows[np.arange(len(rows)), largest]
    quaternions /= np.linalg.norm(quaternions, axis=1, keepdims=True)
    quaternions[quaternions[:, 0] < 0] *= -1.0
    return np.concatenate([transforms[:, :3, 3], quaternions], axis=1)


def skew(vector: Sequence[float] | Array) -> Array:
    """Return the (3, 3) matrix S with `S @ v == cross(vector, v)`."""
    x, y, z = vector
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def rotation_from_vector(vector: Sequence[float] | Array) -> Array:
    """Return the (3, 3) rotation by `|vector|` radians about `vector` (3,), by Rodrigues' formula."""
    v = np.asarray(vector, dtype=float)
    angle = float(np.linalg.norm(v))
    if angle < 1e-12:
        return np.eye(3) + skew(v)
    S = skew(v / angle)
    return np.eye(3) + math.sin(angle) * S + (1.0 - math.cos(angle)) * (S @ S)


def rotation_angle(R_a: Array, R_b: Array) -> float:
    """Return the angle between two orientations (3, 3) [rad], accurate near 0 and near pi."""
    R = R_a.T @ R_b
    sine = 0.5 * math.sqrt((R[2, 1] - R[1, 2]) ** 2 + (R[0, 2] - R[2, 0]) ** 2 + (R[1, 0] - R[0, 1]) ** 2)
    return math.atan2(sine, 0.5 * (R[0, 0] + R[1, 1] + R[2, 2] - 1.0))


def rotation_x(angle: float) -> Array:
    """Return the (3, 3) rotation about x [rad]."""
    return rotation_from_vector([angle, 0.0, 0.0])


def rotation_y(angle: float) -> Array:
    """Return the (3, 3) rotation about y [rad]."""
    return rotation_from_vector([0.0, angle, 0.0])


def rotation_z(angle: float) -> Array:
    """Return the (3, 3) rotation about z [rad]."""
    return rotation_from_vector([0.0, 0.0, angle])


def frame_from_z(z_axis: Sequence[float] | Array, x_hint: Sequence[float] | Array) -> Array:
    """Return the right-handed rotation whose z is `z_axis` and whose x is `x_hint` projected square to it."""
    z = np.asarray(z_axis, dtype=float)
    z = z / np.linalg.norm(z)
    x = np.asarray(x_hint, dtype=float)
    x = x - z * float(x @ z)
    x = x / np.linalg.norm(x)
    return np.column_stack([x, np.cross(z, x), z])
