"""Whether surfaces are covered: the lip of a cup by what it sits on, a mesh by its convex parts.

All of it is one question, whether convex regions cover a convex polygon.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planners.certify.geometry.body_shape import BodyShape, ConvexPart
from planners.geometry.pose import Array

_SIDES = 48
"""Of the polygon about the disc: 0.2 % wider than it at its corners, never narrower."""
_FLAT = 1e-14
"""Twice the area below which a triangle, seen along the axis, is none [m²]: a wall, or thinner than any seam."""
_TOGETHER = 4096
"""Points that are compared with all planes of a part at a time: a part may have thousands."""


def uncovered_point(polygon: Array, regions: Array) -> Array | None:
    """Return a point of a polygon that no region contains, None if together they cover it.

    Region after region is cut off the polygon, each time one that the middle of what is left lies in: either such a
    middle is found in none, or in the end nothing is left. Exact but for rounding: regions that are to meet without a
    gap should overlap by a hair.

    Args:
        polygon: (k, d) corners in order, of a convex polygon in the plane or in space [m].
        regions: (n, f, d + 1) rows a, b of half-spaces a·x + b <= 0, which meet in a convex region each.

    Returns:
        (d,) [m].
    """
    left = [(polygon, regions)]
    while left:
        piece, regions = left.pop()
        heights = regions[:, :, :-1] @ piece.T + regions[:, :, -1:]
        near = ~np.any(np.all(heights > 0.0, axis=2), axis=1)
        regions, heights = regions[near], heights[near]
        middle = piece.mean(axis=0)
        around = np.flatnonzero(np.all(regions[:, :, :-1] @ middle + regions[:, :, -1] <= 0.0, axis=1))
        if len(around) == 0:
            return middle
        if np.any(np.all(heights[around] <= 0.0, axis=(1, 2))):
            continue
        cutting = around[0]
        others = np.delete(regions, cutting, axis=0)
        crossing = np.any(heights[cutting] > 0.0, axis=1)
        left += [(outside, others) for outside in _cut_off(piece, regions[cutting, crossing])]
    return None


def _cut_off(polygon: Array, planes: Array) -> list[Array]:
    """Return the convex pieces of a polygon that are outside a region, of which these planes cross the polygon."""
    pieces = []
    for plane in planes:
        heights = polygon @ plane[:-1] + plane[-1]
        if np.all(heights <= 0.0):
            continue
        pieces.append(_side(polygon, -heights))
        polygon = _side(polygon, heights)
    return pieces


def _side(polygon: Array, heights: Array) -> Array:
    """Return the part of a polygon where heights, given at its corners, are not positive."""
    next_heights = np.roll(heights, -1)
    crossing = (heights > 0.0) != (next_heights > 0.0)
    share = np.divide(heights, heights - next_heights, out=np.zeros_like(heights), where=crossing)
    between = polygon + share[:, None] * (np.roll(polygon, -1, axis=0) - polygon)
    kept = np.column_stack([heights <= 0.0, crossing]).ravel()
    return np.stack([polygon, between], axis=1).reshape(-1, polygon.shape[1])[kept]


@dataclass(frozen=True)
class SealingDisc:
    """A soft disc about the origin, its axis along z."""

    radius: float
    """[m]"""
    give: float
    """How far it follows the surface to either side of its plane [m]."""
    seam: float
    """How far beyond its sides a triangle seals [m]."""

    @property
    def outer_radius(self) -> float:
        """Of the polygon that stands for it, at the corners [m]."""
        return self.radius / math.cos(math.pi / _SIDES)

    def gap(self, triangles: Array) -> Array | None:
        """Return a place (2,) of the disc that does not lie on the surface, None if all of it does.

        Args:
            triangles: (m, 3, 3) corners, counter-clockwise from outside, in the frame of the disc [m].
        """
        angles = 2.0 * math.pi * (np.arange(_SIDES) + 0.5) / _SIDES
        polygon = self.outer_radius * np.column_stack([np.cos(angles), np.sin(angles)])
        return uncovered_point(polygon, self._sealing(triangles))

    def _sealing(self, triangles: Array) -> Array:
        """Return in which parts of the plane triangles that face the disc are near enough: rows for each (m, 5, 3)."""
        reach = np.array([self.outer_radius, self.outer_radius, self.give])
        near = np.all((triangles.min(axis=1) <= reach) & (triangles.max(axis=1) >= -reach), axis=1)
        corners = triangles[near]
        flat = corners[..., :2]
        sides = np.roll(flat, -1, axis=1) - flat
        # Twice the area, positive where the triangle is seen from outside.
        areas = sides[:, 0, 0] * sides[:, 1, 1] - sides[:, 0, 1] * sides[:, 1, 0]
        seen = areas > _FLAT
        corners, flat, sides, areas = corners[seen], flat[seen], sides[seen], areas[seen]
        outward = np.stack([sides[..., 1], -sides[..., 0]], axis=2) / np.linalg.norm(sides, axis=2, keepdims=True)
        beside = np.dstack([outward, -np.einsum("mki,mki->mk", outward, flat) - self.seam])
        # The height over the plane is linear: corner k has a share of it that falls towards the side opposite.
        rises = -np.roll(outward * np.linalg.norm(sides, axis=2, keepdims=True), -1, axis=1) / areas[:, None, None]
        slope = np.einsum("mki,mk->mi", rises, corners[..., 2])
        height = corners[:, 0, 2] - np.einsum("mi,mi->m", slope, flat[:, 0])
        within = [np.column_stack([sign * slope, sign * height - self.give]) for sign in (1.0, -1.0)]
        return np.concatenate([beside, np.stack(within, axis=1)], axis=1)


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
