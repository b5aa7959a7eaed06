"""Convex hulls of meshes: read, simplified without leaving anything uncovered, and with faces."""

from __future__ import annotations

from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

from planners.errors import AssetError
from planners.geometry.pose import Array
from planners.scene.asset_files import MeshFile

Hull = tuple[Array, NDArray[np.int64]]
"""Vertices (n, 3) [m] and triangles (m, 3), counter-clockwise from outside."""


@dataclass(frozen=True)
class HullSettings:
    """How closely `enclosing_hull` follows a mesh. Support queries walk all vertices of a hull."""

    most_vertices: int = 60
    """At 60 the arm links come out at most 3.3 mm too large, wrist and gripper 1.6 mm."""
    tolerance: float = 2e-4
    """Fewer vertices will do where they leave no more than this uncovered, before they are pushed out [m]."""
    rounds: int = 20
    """How often vertices are pushed outwards; what is still uncovered after 20 is below 0.1 mm."""


def mesh_path(mesh: MeshFile) -> Path:
    """Return where an installed package keeps a mesh, without importing the package.

    Raises:
        AssetError: The package is not installed or has no such file.
    """
    spec = find_spec(mesh.package)
    if spec is None or not spec.submodule_search_locations:
        raise AssetError(f"the package {mesh.package!r} is not installed; it ships {mesh.path}")
    file = Path(spec.submodule_search_locations[0]) / mesh.path
    if not file.is_file():
        raise AssetError(f"the package {mesh.package!r} ships no {mesh.path}")
    return file


def hull_points(mesh: MeshFile) -> Array:
    """Return the corners (n, 3) of the convex hull of an OBJ file, in its own frame [m].

    Raises:
        AssetError: There is no such file, or it spans no volume.
    """
    path = mesh_path(mesh)
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
        rows = [line.split()[1:4] for line in lines if line.startswith("v ")]
        points = np.array(rows, dtype=float).reshape(-1, 3) * mesh.scale
        return points[ConvexHull(points).vertices]
    except (QhullError, ValueError) as error:
        raise AssetError(f"{mesh.path} of the package {mesh.package!r} spans no volume") from error


def hull_with_faces(points: Array) -> Hull:
    """Return the convex hull of `points` (n, 3) as a closed surface of triangles."""
    hull = ConvexHull(points)
    index = np.full(len(points), -1, dtype=np.int64)
    index[hull.vertices] = np.arange(len(hull.vertices))
    vertices, faces = points[hull.vertices], index[hull.simplices]
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    inward = np.einsum("ij,ij->i", np.cross(b - a, c - a), hull.equations[:, :3]) < 0.0
    faces[inward] = faces[inward][:, ::-1]
    return vertices, faces


def enclosing_hull(points: Array, settings: HullSettings | None = None) -> Array:
    """Return few vertices whose hull contains all `points`.

    Vertices are picked one by one, each the point farthest outside the hull so far; then pushed outwards, out of the
    faces that still cut points off; and last scaled about their centre until nothing is outside. Flat faces stay
    where they are, which growing the whole hull by a radius would not achieve.

    Args:
        points: (n, 3) corners of a convex hull [m].
        settings: how many vertices to spend.

    Returns:
        (m, 3) vertices [m].
    """
    settings = settings or HullSettings()
    if len(points) <= settings.most_vertices:
        return points
    vertices = points[_farthest_points(points, settings)]
    for _ in range(settings.rounds):
        vertices = _pushed_out(vertices, points)
    return _scaled_around(vertices, points)


def _farthest_points(points: Array, settings: HullSettings) -> list[int]:
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float)
    directions = np.vstack([np.eye(3), -np.eye(3), corners])
    chosen = list(dict.fromkeys(np.argmax(points @ directions.T, axis=0).tolist()))
    while len(chosen) < settings.most_vertices:
        planes = ConvexHull(points[chosen]).equations
        outside = (points @ planes[:, :3].T + planes[:, 3]).max(axis=1)
        farthest = int(np.argmax(outside))
        if outside[farthest] <= settings.tolerance:
            break
        chosen.append(farthest)
    return chosen


def _pushed_out(vertices: Array, points: Array) -> Array:
    """Move each vertex half the depth of the cuts of its faces along their normals, deep cuts counting most."""
    hull = ConvexHull(vertices)
    normals = hull.equations[:, :3]
    cuts = np.maximum((points @ normals.T + hull.equations[:, 3]).max(axis=0), 0.0)
    shift, weight = np.zeros_like(vertices), np.zeros(len(vertices))
    for corner in range(3):
        np.add.at(shift, hull.simplices[:, corner], normals * cuts[:, None] ** 2)
        np.add.at(weight, hull.simplices[:, corner], cuts)
    return vertices + 0.5 * shift / np.maximum(weight, 1e-12)[:, None]


def _scaled_around(vertices: Array, points: Array) -> Array:
    """Scale the hull of `vertices` about their mean by the least factor that takes all `points` in."""
    center = vertices.mean(axis=0)
    planes = ConvexHull(vertices).equations
    depth = -(planes[:, :3] @ center + planes[:, 3])
    reach = ((points - center) @ planes[:, :3].T).max(axis=0)
    return center + max(1.0, float((reach / depth).max())) * (vertices - center)
