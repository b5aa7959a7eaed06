"""The shape of a document's body: convex parts with their vertices and faces."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

from planners.certify.geometry.triangle_surface import TriangleSurface
from planners.geometry.pose import Array

_CYLINDER_SIDES = 64
"""A circumscribed polygon: 0.12 % wider than the circle at its corners, never narrower."""


@dataclass(frozen=True, eq=False)
class ConvexPart:
    """A convex polytope."""

    vertices: Array
    """(n, 3), corners only [m]."""
    triangles: NDArray[np.intp]
    """(m, 3) indices of corners, counter-clockwise from outside."""
    planes: Array
    """(f, 4), one row a face, n·x + d <= 0 inside, without repetitions."""

    @cached_property
    def edges(self) -> Array:
        """(e, 3) unit directions of the edges between faces that are not one plane, each direction once."""
        corners = self.vertices[self.triangles]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        sides = np.sort(
            np.vstack([self.triangles[:, [0, 1]], self.triangles[:, [1, 2]], self.triangles[:, [2, 0]]]), axis=1
        )
        order = np.lexsort(sides.T)
        sides, faces = sides[order], np.tile(np.arange(len(normals)), 3)[order]
        # Every side of a closed surface belongs to two triangles, which sorting puts next to one another.
        sharp = np.einsum("ij,ij->i", normals[faces[::2]], normals[faces[1::2]]) < 1 - 1e-9
        directions = self.vertices[sides[::2][sharp, 1]] - self.vertices[sides[::2][sharp, 0]]
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        leading = np.take_along_axis(directions, np.argmax(np.abs(directions), axis=1)[:, None], axis=1)
        return np.unique(np.round(directions * np.sign(leading), 9), axis=0)


@dataclass(frozen=True, eq=False)
class BodyShape:
    """A rigid shape: the union of convex parts, in the body frame."""

    vertices: Array
    """(n, 3), all corners [m]."""
    parts: tuple[ConvexPart, ...]
    surface: TriangleSurface | None = None
    """Closed; None where the parts' faces are the surface."""

    @property
    def triangles(self) -> Array:
        """(m, 3, 3) corners of outward triangles, closed [m]."""
        if self.surface is not None:
            return self.surface.triangles
        return np.concatenate([part.vertices[part.triangles] for part in self.parts])

    def inertia(self, mass: float, point: Array) -> Array:
        """Return the moment of inertia about a point of a homogeneous body of this shape: (3, 3) [kg m²].

        The second moments of the tetrahedra between the point and each face's triangles are added up, signed.
        """
        a, b, c = np.swapaxes(self.triangles - point, 0, 1)
        volumes = np.einsum("ni,ni->n", a, np.cross(b, c)) / 6.0
        corners = np.stack([a, b, c, a + b + c], axis=1)
        second = np.einsum("n,nki,nkj->ij", volumes, corners, corners) / 20.0 * (mass / volumes.sum())
        return np.trace(second) * np.eye(3) - second

    def surface_distance(self, point: Array) -> tuple[float, Array]:
        """Return the distance of a point from the nearest face's plane, negative inside, and its outward normal.

        Exact beside a face, an underestimate beyond an edge; for several parts, of the part nearest to the point. Of a
        mesh it is the distance from the nearest triangle.
        """
        if self.surface is not None:
            return self.surface.signed_distance(point)
        best, normal = math.inf, np.zeros(3)
        for part in self.parts:
            heights = part.planes[:, :3] @ point + part.planes[:, 3]
            face = int(np.argmax(heights))
            if heights[face] < best:
                best, normal = float(heights[face]), part.planes[face, :3]
        return best, normal

    def normals_near(self, point: Array, distance: float) -> list[Array]:
        """Return the outward normals of the faces that a point is no farther than `distance` from."""
        normals = []
        if self.surface is not None:
            return list(self.surface.normals_near(point, distance))
        for part in self.parts:
            heights = part.planes[:, :3] @ point + part.planes[:, 3]
            if heights.max() <= distance:
                normals += list(part.planes[heights >= -distance, :3])
        return normals

    def faces_near(self, points: Array, distance: float) -> tuple[Array, NDArray[np.bool_]]:
        """Return normals (f, 3) of faces, and which of them are near each of the points (n, 3), see `normals_near`."""
        if self.surface is not None:
            return self.surface.faces_near(points, distance)
        masks = []
        for part in self.parts:
            heights = points @ part.planes[:, :3].T + part.planes[:, 3]
            masks.append((heights >= -distance) & (heights.max(axis=1, keepdims=True) <= distance))
        near = np.concatenate(masks, axis=1)
        met = near.any(axis=0)
        return np.concatenate([part.planes[:, :3] for part in self.parts])[met], near[:, met]


def convex_part(points: Array) -> ConvexPart:
    """Return the convex hull of (n, 3) points.

    Raises:
        ValueError: The points are flat.
    """
    try:
        hull = ConvexHull(points)
    except (QhullError, ValueError) as error:
        raise ValueError("the points span no volume") from error
    index = np.full(len(points), -1)
    index[hull.vertices] = np.arange(len(hull.vertices))
    triangles = index[hull.simplices]
    vertices = np.ascontiguousarray(points[hull.vertices], dtype=float)
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    inward = np.einsum("ij,ij->i", np.cross(b - a, c - a), hull.equations[:, :3]) < 0
    triangles[inward] = triangles[inward][:, ::-1]
    planes = np.unique(np.round(hull.equations, 9), axis=0)
    return ConvexPart(vertices, np.ascontiguousarray(triangles), planes)


def _single(points: Array) -> BodyShape:
    part = convex_part(points)
    return BodyShape(part.vertices, (part,))


def box(size: Array) -> BodyShape:
    """Return a box of full lengths `size` about the origin."""
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float)
    return _single(signs * size / 2)


def cylinder(radius: float, height: float) -> BodyShape:
    """Return a prism around a cylinder about z."""
    angles = 2 * math.pi * np.arange(_CYLINDER_SIDES) / _CYLINDER_SIDES
    corner = radius / math.cos(math.pi / _CYLINDER_SIDES)
    return prism(corner * np.column_stack([np.cos(angles), np.sin(angles)]), height)


def prism(outline: Array, height: float) -> BodyShape:
    """Return the prism over a convex (n, 2) outline, its origin at mid-height.

    Raises:
        ValueError: The outline has no area.
    """
    rings = [np.column_stack([outline, np.full(len(outline), z)]) for z in (-height / 2, height / 2)]
    return _single(np.vstack(rings))


def closed_surface(triangles: Array) -> BodyShape:
    """Return a shape of which the closed surface is known, (m, 3, 3) outward corners, and no parts but its hull."""
    vertices = np.unique(triangles.reshape(-1, 3), axis=0)
    return BodyShape(vertices, (convex_part(vertices),), TriangleSurface(triangles))


def mesh(vertices: Array, faces: NDArray[np.intp], parts: Sequence[Array]) -> BodyShape:
    """Return a mesh with its convex parts, each by its points.

    Raises:
        ValueError: A part is flat, or the surface has no volume inside.
    """
    surface = vertices[faces]
    a, b, c = np.swapaxes(surface, 0, 1)
    if float(np.einsum("ij,ij->", a, np.cross(b, c))) <= 0.0:
        raise ValueError("the surface is not closed and outward")
    flat = np.linalg.norm(np.cross(b - a, c - a), axis=1) == 0.0
    return BodyShape(vertices, tuple(convex_part(part) for part in parts), TriangleSurface(surface[~flat]))
