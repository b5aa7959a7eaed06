"""Meshes as people have them, made into solids: repaired where that is safe, else refused with the reason.

Repaired are vertices that are given once for every triangle, triangles without area or given twice, triangles that
are turned over, and whole meshes inside out. Everything else would be a guess.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from functools import cached_property
from typing import Self, TypedDict

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import breadth_first_order, connected_components
from scipy.spatial import ConvexHull

from planners.geometry.convex import ConvexShape, enclosing_hull
from planners.geometry.convex_cover import CoverSettings, cover
from planners.geometry.mesh_file import MeshFormat, MeshRefused, read_mesh_file
from planners.geometry.pose import Array
from planners.geometry.surface import Faces, centroid, shared_sides, triangle_normals, volume, winding_numbers


class MeshDocument(TypedDict):
    """A solid mesh as JSON data; members as of `SolidMesh`."""

    vertices: list[list[float]]
    faces: list[list[int]]
    parts: list[list[list[float]]]
    excess: float


@dataclass(frozen=True, eq=False)
class DrawnParts:
    """Convex shapes with few corners that contain a solid."""

    parts: tuple[ConvexShape, ...]
    """In the solid's frame."""
    excess: float
    """How far they reach beyond the solid at most."""


@dataclass(frozen=True, eq=False)
class SolidMesh:
    """One solid, in its own frame and the unit of its file."""

    vertices: Array
    """(n, 3)"""
    faces: Faces
    """(m, 3), closed, counter-clockwise from outside."""
    parts: tuple[Array, ...]
    """Corners (k, 3) of convex parts whose union contains the solid."""
    excess: float
    """How far the parts reach beyond the solid."""

    @property
    def size(self) -> Array:
        """(3,) full lengths of the box around it."""
        return np.ptp(self.vertices, axis=0)

    @property
    def centroid(self) -> Array:
        """(3,) centre of mass, were it evenly filled."""
        return centroid(self.vertices, self.faces)

    @cached_property
    def drawn(self) -> DrawnParts:
        """The convex parts for collision queries: one with many corners is drawn a little larger, with few."""
        drawn = [enclosing_hull(part) for part in self.parts]
        beyond = max(_beyond(shape, part) for shape, part in zip(drawn, self.parts, strict=True))
        return DrawnParts(tuple(ConvexShape(np.ascontiguousarray(shape)) for shape in drawn), self.excess + beyond)

    def scaled(self, factor: float) -> SolidMesh:
        """Return the mesh with everything `factor` times as large."""
        parts = tuple(factor * part for part in self.parts)
        return SolidMesh(factor * self.vertices, self.faces, parts, factor * self.excess)

    def document(self) -> MeshDocument:
        """Return the mesh as JSON data."""
        return {
            "vertices": self.vertices.tolist(),
            "faces": self.faces.tolist(),
            "parts": [part.tolist() for part in self.parts],
            "excess": self.excess,
        }

    @classmethod
    def from_document(cls, document: MeshDocument) -> Self:
        """Read what `document` wrote."""
        return cls(
            np.array(document["vertices"], dtype=float).reshape(-1, 3),
            np.array(document["faces"], dtype=np.int64).reshape(-1, 3),
            tuple(np.array(part, dtype=float).reshape(-1, 3) for part in document["parts"]),
            float(document["excess"]),
        )


def _beyond(drawn: Array, part: Array) -> float:
    """Bound how far a drawing (m, 3) reaches beyond its part (n, 3) [m]: from its corners to the part's planes."""
    if drawn is part:
        return 0.0
    planes = ConvexHull(part).equations
    nearest = part[np.argmin(np.linalg.norm(drawn[:, None] - part[None], axis=2), axis=1)]
    flat = (drawn @ planes[:, :3].T + planes[:, 3]).max(axis=1)
    return float(np.where(flat > 0.0, np.linalg.norm(drawn - nearest, axis=1), 0.0).max())


SAME_VERTEX = 1e-6
"""Vertices closer together than this share of the diagonal are one; four times as far apart they never are."""
LEAST_VOLUME = 1e-8
"""A mesh that encloses less than this share of its cubed diagonal is flat."""
SHARPEST = 1e-12
"""Triangles with less area than this share of the squared diagonal have none."""
CROSSING_PROBES = 48
"""Triangles whose two sides are checked for being outside and inside."""
PROBE_DISTANCE = 1e-5
"""From the triangle, as a share of the diagonal."""


def take_mesh(content: bytes, file_format: MeshFormat, settings: CoverSettings | None = None) -> SolidMesh:
    """Make a solid of a file.

    Raises:
        MeshRefused: The file cannot be read, or its mesh encloses no one solid.
    """
    vertices, faces = read_mesh_file(content, file_format)
    vertices, faces = repaired(vertices, faces)
    found = cover(vertices, faces, settings)
    return SolidMesh(vertices, faces, found.parts, found.excess)


def repaired(vertices: Array, faces: Faces) -> tuple[Array, Faces]:
    """Make triangles the closed, outward surface of one solid.

    Raises:
        MeshRefused: It is open, not a surface, in several pieces, flat, or goes through itself.
    """
    if not np.all(np.isfinite(vertices)) or float(np.abs(vertices).max(initial=0.0)) > 1e9:
        raise MeshRefused("the mesh has coordinates that are not finite")
    vertices, faces = _merged(vertices, faces)
    neighbours = _neighbours(faces)
    faces = _turned_alike(faces, neighbours)
    diagonal = float(np.linalg.norm(np.ptp(vertices, axis=0)))
    enclosed = volume(vertices - vertices.mean(axis=0), faces)
    if abs(enclosed) < LEAST_VOLUME * diagonal**3:
        raise MeshRefused("the mesh is flat: it encloses no volume")
    if enclosed < 0.0:
        faces = faces[:, ::-1].copy()
    _refuse_crossings(vertices, faces, diagonal)
    return vertices, faces


def _merged(vertices: Array, faces: Faces) -> tuple[Array, Faces]:
    """Give equal vertices one number, and drop triangles that have no area then, or are there twice."""
    used, faces = _renumbered(faces)
    vertices = vertices[used]
    diagonal = float(np.linalg.norm(np.ptp(vertices, axis=0)))
    if diagonal == 0.0:
        raise MeshRefused("the mesh is a single point")
    _, first, inverse = np.unique(clusters(vertices, SAME_VERTEX * diagonal), return_index=True, return_inverse=True)
    vertices, faces = vertices[first], inverse[faces]
    distinct = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    faces = faces[distinct]
    _, once = np.unique(np.sort(faces, axis=1), axis=0, return_index=True)
    faces = faces[np.sort(once)]
    if len(faces) == 0:
        raise MeshRefused("the mesh is flat: no triangle has an area")
    used, faces = _renumbered(faces)
    return vertices[used], faces


def _renumbered(faces: Faces) -> tuple[Faces, Faces]:
    """Return the vertex numbers (k,) that triangles use, and the triangles (m, 3) in terms of places in that list."""
    used, places = np.unique(faces, return_inverse=True)
    return used, places.reshape(-1, 3).astype(np.int64)


def _neighbours(faces: Faces) -> Faces:
    """Return rows (triangle, triangle, 1 if both run along their common edge the same way).

    Raises:
        MeshRefused: An edge does not belong to two triangles, or the triangles are not connected.
    """
    sides, bounds = shared_sides(faces)
    count = np.diff(bounds)
    if np.any(count == 1):
        raise MeshRefused(f"the mesh is open: {int(np.sum(count == 1))} edges belong to one triangle only")
    if np.any(count > 2):
        raise MeshRefused(f"the mesh is no surface: {int(np.sum(count > 2))} edges belong to more than two triangles")
    pairs = sides.reshape(-1, 2)
    same_way = faces.ravel()[pairs[:, 0]] == faces.ravel()[pairs[:, 1]]
    rows = np.column_stack([pairs // 3, same_way]).astype(np.int64)
    graph = coo_array((np.ones(len(rows)), (rows[:, 0], rows[:, 1])), shape=(len(faces), len(faces)))
    pieces, _ = connected_components(graph, directed=False)
    if pieces > 1:
        raise MeshRefused(f"the mesh has {pieces} closed surfaces: give one solid without cavities, each in a file")
    return rows


def _turned_alike(faces: Faces, neighbours: Faces) -> Faces:
    """Turn triangles (m, 3) over until all look to the same side; `neighbours` as of `_neighbours`.

    Raises:
        MeshRefused: The surface has one side only.
    """
    if not np.any(neighbours[:, 2]):
        return faces
    size = len(faces)
    graph = coo_array((neighbours[:, 2] + 1.0, (neighbours[:, 0], neighbours[:, 1])), shape=(size, size)).tocsr()
    graph = graph + graph.T
    order, before = breadth_first_order(graph, 0, directed=False)
    over = np.zeros(size, dtype=bool)
    for triangle in order[1:]:
        over[triangle] = over[before[triangle]] ^ _runs_alike(faces, before[triangle], triangle)
    if np.any(over[neighbours[:, 0]] ^ over[neighbours[:, 1]] ^ neighbours[:, 2].astype(bool)):
        raise MeshRefused("the mesh has one side only: its triangles cannot all look outward")
    turned = faces.copy()
    turned[over] = turned[over][:, ::-1]
    return turned


def _runs_alike(faces: Faces, a: int, b: int) -> bool:
    """Tell whether two neighbouring triangles run along their common edge the same way."""
    sides = {(int(faces[a, k]), int(faces[a, (k + 1) % 3])) for k in range(3)}
    return any((int(faces[b, k]), int(faces[b, (k + 1) % 3])) in sides for k in range(3))


def _refuse_crossings(vertices: Array, faces: Faces, diagonal: float) -> None:
    """Look at both sides of some triangles: behind is inside, in front outside, unless the mesh crosses itself."""
    normals, areas = triangle_normals(vertices, faces)
    largest = np.argsort(-areas, kind="stable")
    spread = largest[np.unique(np.linspace(0, len(largest) - 1, CROSSING_PROBES).astype(int))]
    spread = spread[areas[spread] > SHARPEST * diagonal**2]
    middles, away = vertices[faces[spread]].mean(axis=1), PROBE_DISTANCE * diagonal * normals[spread]
    front = winding_numbers(vertices[faces], middles + away)
    behind = winding_numbers(vertices[faces], middles - away)
    if np.any(np.abs(front) > 0.5) or np.any(np.abs(behind - 1.0) > 0.5):
        raise MeshRefused("the mesh goes through itself, or has places thinner than can be told")


_HALF_AROUND = tuple(step for step in itertools.product((-1, 0, 1), repeat=3) if step > (0, 0, 0))
"""Steps from a cube to those around it, one of two opposite ones: the other cube takes that step back."""


def clusters(points: Array, radius: float) -> NDArray[np.int64]:
    """Number the clusters of points in the order of their first points, and return each point's: (n,).

    Points no farther apart than `radius` are in one cluster, and so are all that a chain of such steps leads to. A
    step of a cluster is never longer than 2 sqrt(3) radii; whether one between these two lengths is taken is not
    said. Space is divided into cubes as wide as the radius, and occupied cubes that touch are joined: that costs as
    much as sorting the points, also where they coincide and have n² pairs.

    Args:
        points: (n, 3), finite, at least one, and spread over no more than a million radii.
        radius: positive, in the unit of the points.
    """
    cubes = np.floor((points - points.min(axis=0)) / radius).astype(np.int64)
    # One layer of empty cubes behind the last keeps a step from ending in the next row.
    across = cubes.max(axis=0) + 2
    strides = np.array([across[1] * across[2], across[2], 1])
    occupied, owner = np.unique(cubes @ strides, return_inverse=True)
    ends = np.hstack([_touching(occupied, int(strides @ step)) for step in _HALF_AROUND])
    graph = coo_array((np.ones(ends.shape[1]), (ends[0], ends[1])), shape=(len(occupied), len(occupied)))
    _, labels = connected_components(graph, directed=False)
    _, first, number = np.unique(labels[owner], return_index=True, return_inverse=True)
    return np.argsort(np.argsort(first))[number]


def _touching(occupied: NDArray[np.int64], step: int) -> NDArray[np.int64]:
    """Return (2, k) places in the sorted numbers of occupied cubes: of a cube, and of the one that is `step` away."""
    places = np.searchsorted(occupied, occupied + step)
    there = np.flatnonzero(places < len(occupied))
    there = there[occupied[places[there]] == occupied[there] + step]
    return np.stack([there, places[there]])
