"""How far the surface of a mesh reaches beyond its convex parts."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from planners.certify.body_shape import BodyShape, ConvexPart
from planners.certify.covering import uncovered_point
from planners.geometry.pose import Array

_TOGETHER = 4096
"""Points that are compared with all planes of a part at a time: a part may have thousands."""


def beyond_parts(shape: BodyShape, give: float) -> tuple[float, Array]:
    """Return how far the surface reaches beyond all parts, and where [m]; negative where it is inside them.

    Of all corners; and of a place between them if there is one farther out than `give`, which is not the farthest.
    """
    corners, numbers = np.unique(shape.triangles.reshape(-1, 3), axis=0, return_inverse=True)
    triangles = numbers.reshape(-1, 3)
    heights = np.stack([_heights(part, corners, give) for part in shape.parts])
    outermost = int(np.argmax(heights.min(axis=0)))
    worst = _least_height(shape.parts, corners[outermost])
    if worst > give:
        return worst, corners[outermost]
    # A triangle whose corners are in one part is in it.
    within = np.any(np.all((heights <= give)[:, triangles], axis=2), axis=0)
    low, high = (np.array([side(part.vertices, axis=0) for part in shape.parts]) for side in (np.min, np.max))
    for triangle in corners[triangles[~within]]:
        near = np.all((low - give <= triangle.max(axis=0)) & (high + give >= triangle.min(axis=0)), axis=1)
        point = uncovered_point(triangle, _regions([shape.parts[k] for k in np.flatnonzero(near)], triangle, give))
        if point is not None:
            return _least_height(shape.parts, point), point
    return worst, corners[outermost]


def _heights(part: ConvexPart, points: Array, give: float) -> Array:
    """Return how far points (n, 3) are beyond a part: (n,) [m]; infinite where they are beyond its box by `give`."""
    low, high = part.vertices.min(axis=0) - give, part.vertices.max(axis=0) + give
    near: NDArray[np.intp] = np.flatnonzero(np.all((points >= low) & (points <= high), axis=1))
    heights = np.full(len(points), np.inf)
    for some in np.array_split(near, 1 + len(near) // _TOGETHER):
        heights[some] = np.max(points[some] @ part.planes[:, :3].T + part.planes[:, 3], axis=1)
    return heights


def _least_height(parts: Sequence[ConvexPart], point: Array) -> float:
    return min(float(np.max(part.planes[:, :3] @ point + part.planes[:, 3])) for part in parts)


def _regions(parts: Sequence[ConvexPart], triangle: Array, give: float) -> Array:
    """Return the faces of parts, moved outward, that some corner is beyond: (parts, faces, 4).

    Rows that hold everywhere fill up.
    """
    faces = [part.planes - [0.0, 0.0, 0.0, give] for part in parts]
    crossing = [planes[np.any(planes[:, :3] @ triangle.T + planes[:, 3:] > 0.0, axis=1)] for planes in faces]
    regions = np.zeros((len(parts), max(map(len, crossing), default=0), 4))
    for planes, rows in zip(crossing, regions, strict=True):
        rows[: len(planes)] = planes
    return regions
