"""Single vectors of three numbers, in plain arithmetic: array operations take ten times as long on so few."""

from __future__ import annotations

import math

import numpy as np

from planners.geometry.pose import Array


def angle(a: Array, b: Array) -> float:
    """Return the angle between two vectors [rad]."""
    return math.atan2(math.hypot(*_cross(a, b)), float(a @ b))


def cross(a: Array, b: Array) -> Array:
    """Return the vector product of two vectors: (3,)."""
    return np.array(_cross(a, b))


def length(vector: Array) -> float:
    """Return the length of a vector."""
    return math.sqrt(float(vector @ vector))


def _cross(a: Array, b: Array) -> tuple[float, float, float]:
    (ax, ay, az), (bx, by, bz) = a.tolist(), b.tolist()
    return ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
