"""Denavit and Hartenberg's table of an arm whose joint axes are known at zero.

x of each frame is along the common normal of two axes (Denavit and Hartenberg, "A kinematic notation for lower-pair
mechanisms based on matrices", 1955). Closed forms of the inverse want right angles that are right and axes that
meet, and descriptions are rounded: axes that are square, parallel or intersecting but for that are taken to be.
"""

from __future__ import annotations

import math

import numpy as np

from planners.errors import AssetError
from planners.geometry.pose import Array, Transform, inverse, transform

ROUNDED_ANGLE = 1e-4
"""Axes that are so near to parallel or square are meant to be [rad]."""
ROUNDED_LENGTH = 5e-5
"""Axes that pass each other by no more than this are meant to meet [m]."""


def table_of_axes(axes: Array, points: Array, T_root_tip: Transform) -> tuple[Transform, Array]:
    """Return where frame 0 is, and the table that leads from it to the tip.

    Args:
        axes: (6, 3) unit vectors of the joints' axes at zero, in the frame of a root.
        points: (6, 3) a point of each [m].
        T_root_tip: (4, 4) at zero.

    Returns:
        `T_root_0`, the identity where the first axis is the root's z axis, and (6, 4) columns a, alpha, d, theta0.

    Raises:
        AssetError: No table leads to the tip, whose x axis is not square to the last axis or leads past it.
    """
    T_root_0 = _first_frame(axes[0], points[0])
    dh, frame = np.zeros((6, 4)), T_root_0
    axis = axes[0]
    for i in range(1, 6):
        axis = _as_meant(axes[i], axis)
        x, origin = _next_frame(frame, axis, points[i])
        dh[i - 1] = _row(frame, x, axis, origin)
        frame = transform(np.column_stack([x, np.cross(axis, x), axis]), origin)
    dh[5] = _last_row(inverse(frame) @ T_root_tip)
    return T_root_0, dh


def _as_meant(axis: Array, before: Array) -> Array:
    """Return an axis that is exactly parallel or square to the one before, if it is that but for rounding."""
    along = float(axis @ before)
    if float(np.linalg.norm(np.cross(before, axis))) < ROUNDED_ANGLE:
        return math.copysign(1.0, along) * before
    if abs(along) < ROUNDED_ANGLE:
        axis = axis - along * before
        return axis / np.linalg.norm(axis)
    return axis


def _first_frame(axis: Array, point: Array) -> Transform:
    """Return `T_root_0`: the root's own frame where the first axis is its z, else as near to it as can be."""
    root = np.eye(3)
    if (
        np.linalg.norm(np.cross(root[2], axis)) < ROUNDED_ANGLE
        and axis[2] > 0.0
        and np.hypot(*point[:2]) < ROUNDED_LENGTH
    ):
        return np.eye(4)
    x = next(hint for hint in root if abs(hint @ axis) < 0.9)
    x = x - (x @ axis) * axis
    x /= np.linalg.norm(x)
    return transform(np.column_stack([x, np.cross(axis, x), axis]), point - (point @ axis) * axis)


def _next_frame(frame: Transform, axis: Array, point: Array) -> tuple[Array, Array]:
    """Return x and origin of the frame on the next axis: where the common normal from the z of `frame` ends."""
    before, start = frame[:3, 2], frame[:3, 3]
    x = np.cross(before, axis)
    if np.linalg.norm(x) < ROUNDED_ANGLE:
        # Parallel axes have a common normal anywhere: the one that begins where the last one ended.
        across = point - start - ((point - start) @ before) * before
        if np.linalg.norm(across) < ROUNDED_LENGTH:
            return frame[:3, 0], start
        return _near(across, frame[:3, 0]), start + across
    x = _near(x, frame[:3, 0])
    # start + s before + a x = point + t axis
    steps = np.linalg.solve(np.column_stack([before, x, -axis]), point - start)
    return x, point + float(steps[2]) * axis


def _near(normal: Array, x: Array) -> Array:
    """Return the unit vector along a normal, turned towards another, so that offsets of joints are small."""
    return normal / math.copysign(float(np.linalg.norm(normal)), float(normal @ x))


def _row(frame: Transform, x: Array, axis: Array, origin: Array) -> list[float]:
    """Return a, alpha, d, theta0 that lead from a frame to the next, at zero."""
    before, shift = frame[:3, 2], origin - frame[:3, 3]
    alpha = math.atan2(float(x @ np.cross(before, axis)), float(before @ axis))
    theta = math.atan2(float(x @ frame[:3, 1]), float(x @ frame[:3, 0]))
    return [_zeroed(float(shift @ x)), _squared(alpha), _zeroed(float(shift @ before)), theta]


def _last_row(T_5_tip: Transform) -> list[float]:
    """Return a, alpha, d, theta0 of the tip.

    Raises:
        AssetError: A table cannot lead there.
    """
    x, shift = T_5_tip[:3, 0], T_5_tip[:3, 3]
    theta = math.atan2(x[1], x[0])
    aside = abs(float(shift @ [-math.sin(theta), math.cos(theta), 0.0]))
    if abs(x[2]) > ROUNDED_ANGLE or aside > ROUNDED_LENGTH:
        raise AssetError(
            "tip: its x axis must be square to the axis of the last joint, and its origin beside that axis along x "
            "only. Name the link whose z axis is the last joint's, which ROS descriptions call tool0, or add one"
        )
    alpha = math.atan2(T_5_tip[2, 1], T_5_tip[2, 2])
    return [
        _zeroed(float(shift[0] * math.cos(theta) + shift[1] * math.sin(theta))),
        _squared(alpha),
        float(shift[2]),
        theta,
    ]


def _zeroed(length: float) -> float:
    return 0.0 if abs(length) < ROUNDED_LENGTH else length


def _squared(angle: float) -> float:
    """Return the multiple of a right angle that an angle is but for rounding, or the angle."""
    square = round(angle / (0.5 * math.pi)) * 0.5 * math.pi
    return square if abs(angle - square) < ROUNDED_ANGLE else angle
