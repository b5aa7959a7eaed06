"""Whether a soft disc seals on a surface: it lies on it everywhere, over no hole, step or end of it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from planners.certify.covering import uncovered_point
from planners.geometry.pose import Array

_SIDES = 48
"""Of the polygon about the disc: 0.2 % wider than it at its corners, never narrower."""
_FLAT = 1e-14
"""Twice the area below which a triangle, seen along the axis, is none [m²]: a wall, or thinner than any seam."""


@dataclass(frozen=True)
class Disc:
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
