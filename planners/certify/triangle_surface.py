"""A closed surface of triangles, asked how far points are from it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from planners.geometry.pose import Array


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
