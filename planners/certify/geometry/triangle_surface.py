"""A closed surface of triangles: how far points are from it, and where lines are inside."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from planners.geometry.pose import Array, frame_from_z

_HAIR = np.array([2.3e-8, 1.1e-8, 0.0])
"""The line is moved aside by this, so that it runs along no edge of what is placed with care [m]."""


@dataclass(frozen=True, eq=False)
class TriangleSurface:
    """Outward triangles with an area, in the frame of their body."""

    triangles: Array
    """(m, 3, 3) corners [m]."""

    @cached_property
    def normals(self) -> Array:
        """(m, 3) unit, outward."""
        a, b, c = np.swapaxes(self.triangles, 0, 1)
        normals = np.cross(b - a, c - a)
        return normals / np.linalg.norm(normals, axis=1, keepdims=True)

    def signed_distance(self, point: Array) -> tuple[float, Array]:
        """Return the distance of a point from the nearest triangle, negative behind it, and its normal."""
        bound = float(np.min(np.linalg.norm(self._corners - point, axis=1)))
        near = self._near(point, bound)
        distances = self._distances(near, point)
        nearest = near[int(np.argmin(distances))]
        behind = float((point - self._corners[nearest]) @ self.normals[nearest]) < 0.0
        return (-1.0 if behind else 1.0) * float(distances.min()), self.normals[nearest]

    def normals_near(self, point: Array, distance: float) -> Array:
        """Return the normals (k, 3) of the triangles that a point is no farther than `distance` from."""
        near = self._near(point, distance)
        return self.normals[near[self._distances(near, point) <= distance]]

    def faces_near(self, points: Array, distance: float) -> tuple[Array, NDArray[np.bool_]]:
        """Return normals (f, 3), and which of them each of the points (n, 3) is no farther than `distance` from."""
        middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
        near = self._near(middle, distance + float(np.linalg.norm(points - middle, axis=1).max()))
        masks = np.stack([self._distances(near, point) <= distance for point in points])
        met = masks.any(axis=0)
        return self.normals[near[met]], masks[:, met]

    def _near(self, point: Array, reach: float) -> NDArray[np.intp]:
        """Return the triangles whose boxes come within `reach` of a point: the others are farther away."""
        low, high = self._boxes
        gaps = np.maximum(np.maximum(low - point, point - high), 0.0)
        # A hair more, so that rounding drops no triangle that is just as far.
        return np.flatnonzero(np.einsum("ij,ij->i", gaps, gaps) <= (reach * (1.0 + 1e-9) + 1e-12) ** 2)

    def _distances(self, chosen: NDArray[np.intp], point: Array) -> Array:
        """Return the distances of a point from chosen triangles."""
        inside, nearest = np.ones(len(chosen), dtype=bool), np.full(len(chosen), np.inf)
        for starts, sides, inwards, squares in self._sides:
            to_point, side = point - starts[chosen], sides[chosen]
            inside &= np.einsum("ij,ij->i", inwards[chosen], to_point) >= 0.0
            share = np.clip(np.einsum("ij,ij->i", to_point, side) / squares[chosen], 0.0, 1.0)
            nearest = np.minimum(nearest, np.linalg.norm(to_point - share[:, None] * side, axis=1))
        heights = np.abs(np.einsum("ij,ij->i", point - self._corners[chosen], self.normals[chosen]))
        return np.where(inside, heights, nearest)

    @cached_property
    def _corners(self) -> Array:
        return np.ascontiguousarray(self.triangles[:, 0])

    @cached_property
    def _boxes(self) -> tuple[Array, Array]:
        return self.triangles.min(axis=1), self.triangles.max(axis=1)

    @cached_property
    def _sides(self) -> list[tuple[Array, Array, Array, Array]]:
        """Of each of the three sides: where it starts, its way, square to it into the triangle, its length squared."""
        sides = []
        for k in range(3):
            start = np.ascontiguousarray(self.triangles[:, k])
            side = self.triangles[:, (k + 1) % 3] - start
            sides.append((start, side, np.cross(self.normals, side), np.einsum("ij,ij->i", side, side)))
        return sides


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
