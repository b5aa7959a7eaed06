"""Closed surfaces of triangles: what is inside, how far it is to them, and their flat places."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from planners.geometry.pose import Array, frame_from_z

Faces = NDArray[np.int64]
FlatPiece = tuple[Array, Array]
"""(3,) outward unit normal and (k, 3) corners, counter-clockwise from outside [m]."""

SAME_NORMAL = 1e-3
"""Neighbouring triangles belong to one plane when their normals differ by less [rad]."""
CONVEX_SHARE = 1.0 - 1e-6
"""A flat place that fills this share of its convex hull is convex."""

_STRAIGHT = 1e-9
"""A border that turns by less has no corner there [rad]."""


def triangle_normals(vertices: Array, faces: Faces) -> tuple[Array, Array]:
    """Return the unit normals (m, 3) and the areas (m,) [m²]; the normal of a triangle without area is zero."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    cross = np.cross(b - a, c - a)
    length = np.linalg.norm(cross, axis=1)
    return cross / np.where(length > 0.0, length, 1.0)[:, None], 0.5 * length


def shared_sides(faces: Faces) -> tuple[Faces, Faces]:
    """Group the sides of triangles by the edges that they lie on, whichever way they run.

    Args:
        faces: (m, 3) vertex numbers.

    Returns:
        (sides, bounds): `sides[bounds[e]:bounds[e + 1]]` lie on edge e, in rising order. Side 3 t + i runs from corner
        i of triangle t to its next.
    """
    tails, heads = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    key = np.minimum(tails, heads) * (int(faces.max()) + 1) + np.maximum(tails, heads)
    sides = np.argsort(key, kind="stable")
    first = np.flatnonzero(np.diff(key[sides], prepend=-1))
    return sides, np.append(first, len(sides))


def side_neighbours(faces: Faces) -> Faces:
    """Find the triangle beyond each side of each triangle.

    Args:
        faces: (m, 3) vertex numbers.

    Returns:
        (m, 3): the neighbour beyond side k, which runs from corner k to the next; -1 if there is not exactly one, or it
        does not run along the side in the opposite direction.
    """
    tails, heads = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    sides, bounds = shared_sides(faces)
    first = bounds[:-1][np.diff(bounds) == 2]
    one, other = sides[first], sides[first + 1]
    opposite = tails[one] == heads[other]
    one, other = one[opposite], other[opposite]
    neighbours = np.full(len(tails), -1, dtype=np.int64)
    neighbours[one], neighbours[other] = other // 3, one // 3
    return neighbours.reshape(-1, 3)


def volume(vertices: Array, faces: Faces) -> float:
    """Return the volume inside triangles (m, 3) of vertices (n, 3) [m³]; negative where they look inward."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c))) / 6.0


def centroid(vertices: Array, faces: Faces) -> Array:
    """Return the centroid (3,) of the solid inside, evenly filled [m]; parts that overlap count several times.

    That of the tetrahedra between the mean of the vertices and each triangle, signed.
    """
    middle = vertices.mean(axis=0)
    a, b, c = (vertices[faces[:, k]] - middle for k in range(3))
    volumes = np.einsum("ij,ij->i", a, np.cross(b, c)) / 6.0
    return middle + volumes @ (a + b + c) / (4.0 * volumes.sum())


def winding_numbers(corners: Array, points: Array) -> Array:
    """Count how often a surface goes round points: 1 inside, 0 outside.

    The sum of the triangles' solid angles over 4 pi (Van Oosterom, Strackee, "The solid angle of a plane triangle",
    1983).

    Args:
        corners: (m, 3, 3) of the surface's triangles.
        points: (k, 3).

    Returns:
        (k,) numbers [1].
    """
    numbers = np.empty(len(points))
    for i, point in enumerate(points):
        a, b, c = np.moveaxis(corners - point, 1, 0)
        la, lb, lc = (np.linalg.norm(side, axis=1) for side in (a, b, c))
        triple = np.einsum("ij,ij->i", a, np.cross(b, c))
        dots = (np.einsum("ij,ij->i", p, q) * length for p, q, length in ((a, b, lc), (b, c, la), (c, a, lb)))
        numbers[i] = np.sum(np.arctan2(triple, la * lb * lc + sum(dots))) / (2.0 * np.pi)
    return numbers


def distance(vertices: Array, faces: Faces, point: Array) -> float:
    """Return the distance of a (3,) point from the nearest triangle [m]."""
    corners = vertices[faces] - point
    sides = np.roll(corners, -1, axis=1) - corners
    lengths = np.einsum("ijk,ijk->ij", sides, sides)
    along = -np.einsum("ijk,ijk->ij", corners, sides) / np.where(lengths > 0.0, lengths, 1.0)
    on_sides = corners + np.clip(along, 0.0, 1.0)[:, :, None] * sides
    nearest = np.linalg.norm(on_sides, axis=2).min(axis=1)
    normals, areas = triangle_normals(vertices, faces)
    inward = np.cross(normals[:, None, :], sides)
    above = np.all(np.einsum("ijk,ijk->ij", inward, -corners) >= 0.0, axis=1) & (areas > 0.0)
    heights = np.abs(np.einsum("ij,ij->i", normals, corners[:, 0]))
    return float(np.where(above, heights, nearest).min())


def depth(vertices: Array, faces: Faces, point: Array) -> float:
    """Return how far a (3,) point is from the surface [m], negative outside."""
    inside = winding_numbers(vertices[faces], point[None])[0] > 0.5
    return distance(vertices, faces, point) * (1.0 if inside else -1.0)


def hull_faces(vertices: Array) -> list[FlatPiece]:
    """Return the faces of the convex hull of (n, 3) points, coplanar triangles joined."""
    corners, faces = hull_with_faces(vertices)
    normals, areas = triangle_normals(corners, faces)
    groups = coplanar_groups(faces, normals, areas)
    return [_hull_of(corners, faces[group], areas[group] @ normals[group])[0] for group in groups]


def flat_pieces(vertices: Array, faces: Faces) -> list[FlatPiece]:
    """Divide a surface into convex flat pieces: a flat place is one if it is convex, else one for each triangle."""
    normals, areas = triangle_normals(vertices, faces)
    pieces: list[FlatPiece] = []
    for group in coplanar_groups(faces, normals, areas):
        piece, area = _hull_of(vertices, faces[group], areas[group] @ normals[group])
        if areas[group].sum() >= CONVEX_SHARE * area:
            pieces.append(piece)
        else:
            pieces += [(normals[k], vertices[faces[k]]) for k in group if areas[k] > 0.0]
    return pieces


def coplanar_groups(faces: Faces, normals: Array, areas: Array) -> list[Faces]:
    """Return the connected groups of triangles in one plane, as arrays of triangle numbers, largest area first.

    Each triangle of a group has a normal within `SAME_NORMAL` of that of the group's largest one.

    Args:
        faces: (m, 3).
        normals: (m, 3), as of `triangle_normals`.
        areas: (m,), likewise [m²].
    """
    neighbours = side_neighbours(faces)
    free = areas > 0.0
    groups: list[Faces] = []
    for seed in np.argsort(-areas, kind="stable"):
        if not free[seed]:
            continue
        free[seed] = False
        group, front = [seed], [seed]
        while front:
            for other in neighbours[front.pop()]:
                if other >= 0 and free[other] and normals[other] @ normals[seed] > np.cos(SAME_NORMAL):
                    free[other] = False
                    group.append(other)
                    front.append(other)
        groups.append(np.array(group, dtype=np.int64))
    return groups


def _hull_of(vertices: Array, faces: Faces, vector_area: Array) -> tuple[FlatPiece, float]:
    """Return the convex outline of flat triangles, and its area [m²].

    Args:
        vertices: (n, 3) [m].
        faces: (k, 3), the triangles.
        vector_area: (3,), the sum of their normals, each as long as its triangle is large [m²].
    """
    area = float(np.linalg.norm(vector_area))
    normal = vector_area / area
    loop = _boundary_loop(faces)
    corners = None if loop is None else _convex_corners(vertices[loop], normal)
    if corners is not None:
        return (normal, corners), area
    points = vertices[np.unique(faces)]
    R = frame_from_z(normal, np.eye(3)[int(np.argmin(np.abs(normal)))])
    hull = ConvexHull((points - points[0]) @ R[:, :2])
    return (normal, points[hull.vertices]), float(hull.volume)


def _convex_corners(loop: Array, normal: Array) -> Array | None:
    """Drop the points (n, 3) of a flat outline at which it runs straight on; None if it is not convex."""
    sides = np.roll(loop, -1, axis=0) - loop
    after = sides / np.linalg.norm(sides, axis=1)[:, None]
    before = np.roll(after, 1, axis=0)
    sines, cosines = np.cross(before, after) @ normal, np.einsum("ij,ij->i", before, after)
    turns = np.arctan2(sines, cosines)
    # Several small left turns make one full circle, those of an outline that crosses itself make more.
    if turns.min() < -_STRAIGHT or turns.sum() > 3.0 * np.pi:
        return None
    corners = loop[turns > _STRAIGHT]
    return corners if len(corners) > 2 else None


def _boundary_loop(faces: Faces) -> Faces | None:
    """Return the vertex numbers (k,) round connected triangles, counter-clockwise; None if borders are several."""
    sides = {(a, b) for face in faces.tolist() for a, b in zip(face, face[1:] + face[:1], strict=True)}
    following = {a: b for a, b in sides if (b, a) not in sides}
    loop = [next(iter(following))] if following else []
    while loop and len(loop) <= len(following) and (after := following.get(loop[-1])) != loop[0]:
        if after is None:
            return None
        loop.append(after)
    border = sum((b, a) not in sides for a, b in sides)
    return np.array(loop, dtype=np.int64) if loop and len(loop) == len(following) == border else None


Hull = tuple[Array, NDArray[np.int64]]
"""Vertices (n, 3) [m] and triangles (m, 3), counter-clockwise from outside."""


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
