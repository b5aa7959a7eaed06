"""Solids that bodies are made of: an outline extruded along z, which boxes, cylinders and prisms all are."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from planners.contract.shapes import Box, Cylinder, Prism
from planners.geometry import polygon, shapes
from planners.geometry.convex import ConvexShape
from planners.geometry.pose import Array

RIM_POINTS = 96
"""Points that stand for a round outline; the chords lie inside the circle by at most 0.06 % of its radius."""


@dataclass(frozen=True, eq=False)
class FlatFace:
    """A flat face that a solid can rest on, in the solid's frame."""

    normal: Array
    """(3,) unit, out of the solid."""
    corners: Array
    """(k, 3), counter-clockwise seen from outside [m]."""


@dataclass(frozen=True, eq=False)
class Solid:
    """A convex outline extruded along z; the origin is at mid-height."""

    outline: Array
    """(n, 2), counter-clockwise; points on the rim of a cylinder [m]."""
    height: float
    """[m]"""
    is_round: bool
    convex: ConvexShape
    """The solid, or a drawing of it that contains it."""

    def depth(self, point: Sequence[float] | Array) -> float:
        """Return how deep (3,) `point` lies inside [m]: the distance to the nearest face's plane, negative outside."""
        x, y, z = point
        return min(float(polygon.depth_inside(self.outline, np.array([[x, y]]))[0]), 0.5 * self.height - abs(z))

    def flat_faces(self) -> list[FlatFace]:
        """Return the faces it can rest on: bottom, top and, unless it is round, its sides."""
        low = np.column_stack([self.outline, np.full(len(self.outline), -0.5 * self.height)])
        high = low + np.array([0.0, 0.0, self.height])
        faces = [FlatFace(np.array([0.0, 0.0, -1.0]), low[::-1]), FlatFace(np.array([0.0, 0.0, 1.0]), high)]
        if self.is_round:
            return faces
        for i, normal in enumerate(-polygon.inward_normals(self.outline)):
            j = (i + 1) % len(low)
            faces.append(FlatFace(np.append(normal, 0.0), np.array([low[i], low[j], high[j], high[i]])))
        return faces


def solid_of(shape: Box | Cylinder | Prism) -> Solid:
    """Build the solid of a shape of the contract; both have the same frame."""
    match shape:
        case Box():
            x, y, z = (0.5 * length for length in shape.size)
            outline = np.array([[-x, -y], [x, -y], [x, y], [-x, y]])
            return Solid(outline, 2.0 * z, False, shapes.box(shape.size))
        case Prism():
            return Solid(np.array(shape.outline), shape.height, False, shapes.prism(shape.outline, shape.height))
        case Cylinder():
            angles = 2.0 * math.pi * np.arange(RIM_POINTS) / RIM_POINTS
            rim = shape.radius * np.column_stack([np.cos(angles), np.sin(angles)])
            return Solid(rim, shape.height, True, shapes.cylinder(shape.radius, shape.height))
