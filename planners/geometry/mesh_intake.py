"""Meshes as people have them, made into solids: repaired where that is safe, else refused with the reason.

Repaired are vertices that are given once for every triangle, triangles without area or given twice, triangles that
are turned over, and whole meshes inside out. Everything else would be a guess.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import breadth_first_order, connected_components

from planners.geometry.clusters import clusters
from planners.geometry.convex_cover import CoverSettings, cover
from planners.geometry.mesh_file import MeshFormat, MeshRefused, read_mesh_file
from planners.geometry.pose import Array
from planners.geometry.solid_mesh import SolidMesh
from planners.geometry.surface import Faces, triangle_normals, volume, winding_numbers

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
    """Return a closed surface of one solid, outward.

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
    """Return the numbers of the vertices that triangles have, and the triangles by their places among them."""
    used, places = np.unique(faces, return_inverse=True)
    return used, places.reshape(-1, 3).astype(np.int64)


def _neighbours(faces: Faces) -> Faces:
    """Return rows (triangle, triangle, 1 if both run along their common edge the same way).

    Raises:
        MeshRefused: An edge does not belong to two triangles, or the triangles are not connected.
    """
    sides = np.vstack([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    owners = np.tile(np.arange(len(faces)), 3)
    forward = sides[:, 0] < sides[:, 1]
    edges, number, count = np.unique(np.sort(sides, axis=1), axis=0, return_inverse=True, return_counts=True)
    number = number.reshape(-1)
    if np.any(count == 1):
        raise MeshRefused(f"the mesh is open: {int(np.sum(count == 1))} edges belong to one triangle only")
    if np.any(count > 2):
        raise MeshRefused(f"the mesh is no surface: {int(np.sum(count > 2))} edges belong to more than two triangles")
    order = np.argsort(number, kind="stable").reshape(len(edges), 2)
    same_way = forward[order[:, 0]] == forward[order[:, 1]]
    rows = np.column_stack([owners[order], same_way]).astype(np.int64)
    graph = coo_array((np.ones(len(rows)), (rows[:, 0], rows[:, 1])), shape=(len(faces), len(faces)))
    pieces, _ = connected_components(graph, directed=False)
    if pieces > 1:
        raise MeshRefused(f"the mesh has {pieces} closed surfaces: give one solid without cavities, each in a file")
    return rows


def _turned_alike(faces: Faces, neighbours: Faces) -> Faces:
    """Turn triangles over until all look to the same side.

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
    front = winding_numbers(vertices, faces, middles + away)
    behind = winding_numbers(vertices, faces, middles - away)
    if np.any(np.abs(front) > 0.5) or np.any(np.abs(behind - 1.0) > 0.5):
        raise MeshRefused("the mesh goes through itself, or has places thinner than can be told")
