"""Solids that bodies are made of: outlines extruded along z, closed meshes, and several of them joined."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from planners.contract.quantities import Point2
from planners.contract.shapes import Box, Cylinder, Prism
from planners.geometry import polygon, surface
from planners.geometry.convex import ConvexShape, box, cylinder, prism
from planners.geometry.pose import Array, Transform

RIM_POINTS = 96
"""Points that stand for a round outline; the chords lie inside the circle by at most 0.06 % of its radius."""
CENTROID_DIGITS = 9
"""Decimals of a centroid [m]."""

Surface = tuple[Array, NDArray[np.int64]]
"""Vertices (n, 3) [m] and triangles (m, 3), closed and counter-clockwise from outside."""


@dataclass(frozen=True, eq=False)
class FlatFace:
    """A flat, convex face of a solid, in the solid's frame."""

    normal: Array
    """(3,) unit, out of the solid."""
    corners: Array
    """(k, 3), counter-clockwise seen from outside [m]."""


class Solid(ABC):
    """A rigid shape in its own frame."""

    @property
    @abstractmethod
    def convex_parts(self) -> tuple[ConvexShape, ...]:
        """Convex shapes that together contain the solid."""

    @property
    @abstractmethod
    def excess(self) -> float:
        """How far the convex shapes reach beyond the surface at most [m]."""

    @abstractmethod
    def surface(self) -> Surface:
        """Return the solid's surface as closed meshes of triangles, outward.

        A round solid's has chords, inside it by at most 0.06 % of its radius. That of a solid made of several shapes
        is each shape's own.
        """

    @property
    def centroid(self) -> Array:
        """(3,) centre of mass, were it evenly filled [m]; what shapes that overlap have in common counts for each."""
        # To the nanometre, so that it is the same number on every machine; adding zero turns -0.0 into 0.0.
        return np.round(surface.centroid(*self.surface()), CENTROID_DIGITS) + 0.0

    @abstractmethod
    def depth(self, point: Sequence[float] | Array) -> float:
        """Return how deep (3,) `point` lies inside [m], negative outside."""

    def flat_faces(self) -> list[FlatFace]:
        """Return the faces it can rest on: those of its convex hull; of a round solid, only the flat ones."""
        return self._hull_faces

    @cached_property
    def _hull_faces(self) -> list[FlatFace]:
        return [FlatFace(normal, corners) for normal, corners in surface.hull_faces(self.surface()[0])]

    @cached_property
    def hull_planes(self) -> Array:
        """(m, 4) outward normal n and offset d [m] of each face of its convex hull: inside, n · x + d <= 0."""
        return ConvexHull(self.surface()[0]).equations

    @abstractmethod
    def flat_pieces(self) -> list[FlatFace]:
        """Return convex pieces of all flat places of its surface: what may lie on it, lies on these."""


@dataclass(frozen=True, eq=False)
class ExtrudedSolid(Solid):
    """A convex outline extruded along z; the origin is at mid-height."""

    outline: Array
    """(n, 2), counter-clockwise; points on the rim of a cylinder [m]."""
    height: float
    """[m]"""
    is_round: bool
    convex: ConvexShape
    """The solid, or a drawing of it that contains it."""

    @property
    def convex_parts(self) -> tuple[ConvexShape, ...]:
        """The one convex shape it is."""
        return (self.convex,)

    @property
    def excess(self) -> float:
        """Of a round one, how far its drawing with flats reaches beyond one with chords [m]."""
        if not self.is_round:
            return 0.0
        drawn = np.linalg.norm(self.convex.vertices[:, :2], axis=1).max()
        return float(drawn - np.linalg.norm(self.outline, axis=1).min() * math.cos(math.pi / len(self.outline)))

    def surface(self) -> Surface:
        """Return the solid's surface, outward; a round one has `RIM_POINTS` chords."""
        return self._surface

    @cached_property
    def _surface(self) -> Surface:
        n = len(self.outline)
        low, high = self._rings()
        k = np.arange(n)
        after = (k + 1) % n
        fan = np.arange(1, n - 1)
        top = n + np.column_stack([np.zeros_like(fan), fan, fan + 1])
        bottom = np.column_stack([np.zeros_like(fan), fan + 1, fan])
        sides = np.vstack([np.column_stack([k, after, n + after]), np.column_stack([k, n + after, n + k])])
        return np.vstack([low, high]), np.vstack([bottom, top, sides]).astype(np.int64)

    def depth(self, point: Sequence[float] | Array) -> float:
        """Return how deep (3,) `point` lies inside [m]: the distance to the nearest face's plane, negative outside."""
        x, y, z = point
        return min(float(polygon.depth_inside(self.outline, np.array([[x, y]]))[0]), 0.5 * self.height - abs(z))

    def flat_faces(self) -> list[FlatFace]:
        """Return bottom, top and, unless it is round, the sides."""
        return self._flat_faces

    def flat_pieces(self) -> list[FlatFace]:
        """Return its flat faces, which are convex."""
        return self._flat_faces

    @cached_property
    def _flat_faces(self) -> list[FlatFace]:
        low, high = self._rings()
        faces = [FlatFace(np.array([0.0, 0.0, -1.0]), low[::-1]), FlatFace(np.array([0.0, 0.0, 1.0]), high)]
        if self.is_round:
            return faces
        for i, normal in enumerate(-polygon.inward_normals(self.outline)):
            j = (i + 1) % len(low)
            faces.append(FlatFace(np.append(normal, 0.0), np.array([low[i], low[j], high[j], high[i]])))
        return faces

    def _rings(self) -> tuple[Array, Array]:
        low = np.column_stack([self.outline, np.full(len(self.outline), -0.5 * self.height)])
        return low, low + np.array([0.0, 0.0, self.height])


@dataclass(frozen=True, eq=False)
class MeshSolid(Solid):
    """A closed mesh, and convex shapes that contain it."""

    vertices: Array
    """(n, 3) [m]."""
    faces: NDArray[np.int64]
    """(m, 3), counter-clockwise from outside."""
    parts: tuple[ConvexShape, ...]
    parts_excess: float = 0.0
    """How far the convex shapes reach beyond the mesh at most [m]."""

    @property
    def excess(self) -> float:
        """How far the convex shapes reach beyond the mesh at most [m]."""
        return self.parts_excess

    @property
    def convex_parts(self) -> tuple[ConvexShape, ...]:
        """Convex shapes whose union contains the mesh."""
        return self.parts

    def surface(self) -> Surface:
        """Return the mesh."""
        return self.vertices, self.faces

    def depth(self, point: Sequence[float] | Array) -> float:
        """Return how far (3,) `point` is from the nearest triangle [m], negative outside."""
        return surface.depth(self.vertices, self.faces, np.asarray(point, dtype=float))

    def flat_pieces(self) -> list[FlatFace]:
        """Return the flat places of the mesh, whole where they are convex, else in triangles."""
        return self._pieces

    @cached_property
    def _pieces(self) -> list[FlatFace]:
        return [FlatFace(normal, corners) for normal, corners in surface.flat_pieces(self.vertices, self.faces)]


@dataclass(frozen=True, eq=False)
class CompoundSolid(Solid):
    """Solids that are rigidly joined; they may touch or overlap."""

    pieces: tuple[tuple[Solid, Transform], ...]
    """Each with its `T_compound_piece`."""

    @property
    def convex_parts(self) -> tuple[ConvexShape, ...]:
        """Those of all pieces."""
        return self._parts

    @property
    def excess(self) -> float:
        """The largest of the pieces' [m]."""
        return max(solid.excess for solid, _ in self.pieces)

    def surface(self) -> Surface:
        """Return the closed surfaces of all pieces; where pieces overlap, parts of them are inside."""
        return self._surface

    def depth(self, point: Sequence[float] | Array) -> float:
        """Return how deep (3,) `point` lies in the piece that it is deepest in [m], negative outside all."""
        at = np.asarray(point, dtype=float)
        return max(solid.depth(T[:3, :3].T @ (at - T[:3, 3])) for solid, T in self.pieces)

    def flat_pieces(self) -> list[FlatFace]:
        """Return the flat places of all pieces."""
        return [
            FlatFace(T[:3, :3] @ face.normal, face.corners @ T[:3, :3].T + T[:3, 3])
            for solid, T in self.pieces
            for face in solid.flat_pieces()
        ]

    @cached_property
    def _parts(self) -> tuple[ConvexShape, ...]:
        return tuple(part.placed(T) for solid, T in self.pieces for part in solid.convex_parts)

    @cached_property
    def _surface(self) -> Surface:
        vertices: list[Array] = []
        faces: list[NDArray[np.int64]] = []
        count = 0
        for solid, T in self.pieces:
            own_vertices, own_faces = solid.surface()
            vertices.append(own_vertices @ T[:3, :3].T + T[:3, 3])
            faces.append(own_faces + count)
            count += len(own_vertices)
        return np.vstack(vertices), np.vstack(faces)


def solid_of(shape: Box | Cylinder | Prism) -> ExtrudedSolid:
    """Return the solid of a shape of the contract; both have the same frame. Equal shapes share one, and its faces."""
    match shape:
        case Box():
            return _box(*shape.size)
        case Prism():
            return _prism(shape.outline, shape.height)
        case Cylinder():
            return _cylinder(shape.radius, shape.height)


@lru_cache(maxsize=256)
def _box(x: float, y: float, z: float) -> ExtrudedSolid:
    return ExtrudedSolid(polygon.rectangle(x, y), z, False, box((x, y, z)))


@lru_cache(maxsize=256)
def _prism(outline: tuple[Point2, ...], height: float) -> ExtrudedSolid:
    return ExtrudedSolid(np.array(outline), height, False, prism(outline, height))


@lru_cache(maxsize=256)
def _cylinder(radius: float, height: float) -> ExtrudedSolid:
    return ExtrudedSolid(polygon.circle(radius, RIM_POINTS), height, True, cylinder(radius, height))
