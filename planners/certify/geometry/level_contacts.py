"""Where level faces of one body, or corners, stand on level faces of another."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from planners.certify.geometry.body_shape import BodyShape
from planners.geometry.pose import Array, Transform

LEVEL = math.cos(math.radians(0.1))
"""Least vertical component of the normal of a face that is level; contract."""
_EDGE = 1e-7
"""Ends of edges that round to the same multiple of this are one; a point so far outside is on the border [m]."""
_BROAD = 1e-5
"""Contacts that are narrower carry nothing: bodies side by side [m]."""


@dataclass(frozen=True, eq=False)
class LevelFaces:
    """A shape where it is, asked for its level triangles, in world coordinates."""

    shape: BodyShape
    T_world_body: Transform

    @cached_property
    def vertices(self) -> Array:
        """(n, 3) [m]."""
        return self.shape.vertices @ self.T_world_body[:3, :3].T + self.T_world_body[:3, 3]

    @cached_property
    def low(self) -> Array:
        """(3,) lower corner of the box around it [m]."""
        return self.vertices.min(axis=0)

    @cached_property
    def high(self) -> Array:
        """(3,) upper corner of the box around it [m]."""
        return self.vertices.max(axis=0)

    @cached_property
    def up(self) -> Array:
        """(m, 3, 3) triangles that look up [m]."""
        return self._looking(1.0)

    @cached_property
    def down(self) -> Array:
        """(m, 3, 3) triangles that look down [m]."""
        return self._looking(-1.0)

    @cached_property
    def feet(self) -> Array:
        """(k, 3) lowest corners of a body that stands on no level face [m]."""
        lowest = self.vertices[self.vertices[:, 2] <= self.low[2] + _BROAD]
        return lowest[:0] if len(self.down) and self.down[:, :, 2].min() <= self.low[2] + _BROAD else lowest

    def _looking(self, way: float) -> Array:
        triangles = self.shape.triangles @ self.T_world_body[:3, :3].T + self.T_world_body[:3, 3]
        normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
        return triangles[way * normals[:, 2] >= LEVEL * np.linalg.norm(normals, axis=1)]


def contact_points(upper: LevelFaces, lower: LevelFaces, touch: float) -> Array:
    """Return corners (k, 2) of where faces of one body that look down are on faces of another that look up.

    Of two regions of the plane these are border ends of one inside the other, and crossings of both borders.
    """
    down, up = _near(upper.down, lower, touch), _near(lower.up, upper, touch)
    feet = _inside(upper.feet, up, touch)
    if not len(down) or not len(up):
        return feet
    rim_down, rim_up = _border(down), _border(up)
    found = np.vstack([
        _inside(rim_down.reshape(-1, 3), up, touch),
        _inside(rim_up.reshape(-1, 3), down, touch),
        _crossings(rim_down, rim_up, touch),
    ])  # fmt: skip
    broad = len(found) > 2 and np.linalg.svd(found - found.mean(axis=0), compute_uv=False)[1] > _BROAD
    return np.vstack([feet, found]) if broad else feet


def _near(triangles: Array, other: LevelFaces, touch: float) -> Array:
    low, high = triangles.min(axis=1), triangles.max(axis=1)
    return triangles[np.all((low <= other.high + touch) & (high >= other.low - touch), axis=1)]


def _border(triangles: Array) -> Array:
    """Return the sides (e, 2, 3) that belong to one triangle only."""
    sides = np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=2).reshape(-1, 2, 3)
    ends = np.round(sides / _EDGE).astype(np.int64)
    swapped = np.array([tuple(a) > tuple(b) for a, b in ends], dtype=bool)
    ends[swapped] = ends[swapped, ::-1]
    _, index, count = np.unique(ends.reshape(-1, 6), axis=0, return_index=True, return_counts=True)
    return sides[index[count == 1]]


def _inside(points: Array, triangles: Array, touch: float) -> Array:
    """Return those of (k, 3) points, as (j, 2), that are over or on one of the triangles, at its height."""
    corners = triangles[:, :, :2]
    sides = np.roll(corners, -1, axis=1) - corners
    lengths = np.linalg.norm(sides, axis=2)
    turning = np.sign(_cross(sides[:, 0], sides[:, 1]))
    kept = []
    for point in np.unique(points, axis=0):
        depths = turning[:, None] * _cross(sides, point[:2] - corners) / lengths
        level = np.abs(triangles[:, 0, 2] - point[2]) <= touch
        if np.any(level & (depths.min(axis=1) >= -_EDGE)):
            kept.append(point[:2])
    return np.array(kept).reshape(-1, 2)


def _crossings(one: Array, other: Array, touch: float) -> Array:
    """Return the points (k, 2) where sides of two borders (e, 2, 3) at one height cross."""
    start, way = one[:, None, 0, :2], (one[:, 1] - one[:, 0])[:, None, :2]
    other_start, other_way = other[None, :, 0, :2], (other[:, 1] - other[:, 0])[None, :, :2]
    sine = _cross(way, other_way)
    with np.errstate(divide="ignore", invalid="ignore"):
        share = _cross(other_start - start, other_way) / sine
        other_share = _cross(other_start - start, way) / sine
    level = np.abs(one[:, None, 0, 2] - other[None, :, 0, 2]) <= touch
    # Shares of parallel sides are no numbers, and not between 0 and 1.
    crossing = level & (share >= 0.0) & (share <= 1.0) & (other_share >= 0.0) & (other_share <= 1.0)
    i, j = np.nonzero(crossing)
    return start[i, 0] + share[i, j, None] * way[i, 0]


def _cross(a: Array, b: Array) -> Array:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
