"""Where a line is inside a solid of closed surfaces, which may touch or overlap."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planners.geometry.pose import Array, frame_from_z

_HAIR = np.array([2.3e-8, 1.1e-8, 0.0])
"""The line is moved aside by this, so that it runs along no edge of what is placed with care [m]."""


def stretches_inside(triangles: Array, point: Array, direction: Array, seam: float) -> Array:
    """Return the stretches of a line inside a solid: (n, 2) where each begins and ends, ascending [m].

    Args:
        triangles: (m, 3, 3) corners of closed surfaces, counter-clockwise from outside [m].
        point: (3,) of the line, from which places along it are counted [m].
        direction: (3,) of the line.
        seam: gaps up to this are none [m].
    """
    R = frame_from_z(direction, np.eye(3)[int(np.argmin(np.abs(direction)))])
    places, entering = _crossings((triangles - point) @ R + _HAIR)
    order = np.lexsort((~entering, places))
    places, turns = places[order], np.where(entering[order], 1, -1)
    depth = np.cumsum(turns)
    begins, ends = places[(depth > 0) & (depth - turns <= 0)], places[(depth <= 0) & (depth - turns > 0)]
    if len(begins) == 0 or len(begins) != len(ends):
        return np.empty((0, 2))
    apart = begins[1:] - ends[:-1] > seam
    return np.column_stack([begins[np.append(True, apart)], ends[np.append(apart, True)]])


def _crossings(local: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Return where the z axis crosses triangles (m, 3, 3), and whether it enters there what they enclose: (n,)."""
    x, y, z = np.moveaxis(local, 2, 0)
    # Twice the areas of the triangles between the axis and each side. Both triangles at an edge get the same one with
    # the other sign, so that the axis never slips through between them.
    areas = np.roll(x, -1, axis=1) * np.roll(y, -2, axis=1) - np.roll(y, -1, axis=1) * np.roll(x, -2, axis=1)
    met = np.all(areas > 0.0, axis=1) | np.all(areas < 0.0, axis=1)
    areas = areas[met]
    # Area k is opposite corner k, which makes it that corner's weight.
    total = areas.sum(axis=1)
    return np.sum(areas * z[met], axis=1) / total, total < 0.0
