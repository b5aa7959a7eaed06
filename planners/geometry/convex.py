"""Convex shapes, and the bodies that are made of them.

Where a round thing is drawn with flats, it lies inside its drawing.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numba import njit
from scipy.spatial import ConvexHull, QhullError

from planners.geometry.polygon import circle
from planners.geometry.pose import Array, Transform

_STEPS = 200
"""Leave a ball less than 1 % too large."""


@njit(cache=True, nogil=True)
def enclosing_ball(vertices: Array) -> Array:
    """Return a ball (centre, radius) around points, close to the least one.

    Badoiu, Clarkson, "Smaller core-sets for balls" (2003): walk towards the farthest point by ever smaller steps.
    """
    center = np.zeros(3)
    for k in range(3):
        center[k] = 0.5 * (vertices[:, k].min() + vertices[:, k].max())
    best = np.zeros(4)
    best[3] = np.inf
    for step in range(_STEPS):
        farthest, square = 0, -1.0
        for i in range(len(vertices)):
            x, y, z = vertices[i, 0] - center[0], vertices[i, 1] - center[1], vertices[i, 2] - center[2]
            if x * x + y * y + z * z > square:
                farthest, square = i, x * x + y * y + z * z
        if square < best[3]:
            best[:3], best[3] = center, square
        center += (vertices[farthest] - center) / (step + 2)
    best[3] = np.sqrt(best[3])
    return best


@dataclass(frozen=True, eq=False)
class ConvexShape:
    """The convex hull of `vertices`, grown by a ball of `radius`: spheres, capsules, boxes and hulls alike."""

    vertices: Array
    """(n, 3), in the frame of the body [m]."""
    radius: float = 0.0
    """[m]"""

    @cached_property
    def face_normals(self) -> Array:
        """(n, 3) outward normals of the faces of the hull; none for a flat or thin one."""
        try:
            planes = ConvexHull(self.vertices).equations[:, :3]
        except (QhullError, ValueError):
            return np.empty((0, 3))
        # Triangles of one face share a normal.
        _, first = np.unique(planes.round(6), axis=0, return_index=True)
        return planes[first]

    @cached_property
    def ball(self) -> Array:
        """(4,) centre and radius of a ball around the vertices [m]."""
        return enclosing_ball(np.ascontiguousarray(self.vertices, dtype=float))

    def placed(self, T_body_shape: Transform) -> ConvexShape:
        """Return the shape, given in its own frame, in the frame of a body; what is known of it goes along."""
        R, p = T_body_shape[:3, :3], T_body_shape[:3, 3]
        moved = ConvexShape(self.vertices @ R.T + p, self.radius)
        # Hulls take long, and fingers are placed anew for every opening.
        moved.__dict__["face_normals"] = self.face_normals @ R.T
        moved.__dict__["ball"] = np.append(R @ self.ball[:3] + p, self.ball[3])
        return moved


NamePair = tuple[str, str]


def sorted_pair(a: str, b: str) -> NamePair:
    """Order the names of two bodies, so that a pair has one name."""
    return (a, b) if a < b else (b, a)


@dataclass(frozen=True, eq=False)
class CollisionBody:
    """A named rigid body for collision queries."""

    name: str
    group: str
    """Who it belongs to: an arm ("left", "right"), or "cell", "plate", "cup", "cable", "support", "obstacle"."""
    frame: str
    """"world", "left/0" (base) to "left/6" (flange; frame after joint i), or the name of a movable frame."""
    shapes: tuple[ConvexShape, ...]
    """Convex parts, in `frame`."""


def capsule(start: Sequence[float] | Array, end: Sequence[float] | Array, radius: float) -> ConvexShape:
    """Return the segment from `start` to `end` grown by `radius` [m]."""
    return ConvexShape(np.array([start, end], dtype=float), radius)


def box(size: Sequence[float] | Array) -> ConvexShape:
    """Return the box of full lengths `size` [m] centred on the origin."""
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float)
    return ConvexShape(0.5 * signs * np.asarray(size, dtype=float))


def prism(outline: Sequence[Sequence[float]] | Array, height: float) -> ConvexShape:
    """Return the convex outline (n, 2) extruded along z, the origin at mid-height [m]."""
    base = np.asarray(outline, dtype=float)
    low = np.column_stack([base, np.full(len(base), -0.5 * height)])
    high = np.column_stack([base, np.full(len(base), 0.5 * height)])
    return ConvexShape(np.vstack([low, high]))


def cylinder(radius: float, height: float, sides: int = 24) -> ConvexShape:
    """Return a prism around the cylinder about z, the origin at its centre [m].

    The flats touch the circle, so the drawing is never smaller than the cylinder: at most `1/cos(pi/sides) - 1`
    of the radius larger (0.9 % with 24 sides).
    """
    return prism(circle(radius / math.cos(math.pi / sides), sides), height)


@dataclass(frozen=True)
class HullSettings:
    """How closely `enclosing_hull` follows a mesh. Support queries walk all vertices of a hull."""

    most_vertices: int = 60
    """At 60 the arm links come out at most 3.3 mm too large, wrist and gripper 1.6 mm."""
    tolerance: float = 2e-4
    """Fewer vertices will do where they leave no more than this uncovered, before they are pushed out [m]."""
    rounds: int = 20
    """How often vertices are pushed outwards; what is still uncovered after 20 is below 0.1 mm."""


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
    # A copy: compiled code takes an array that must not be written to for one of another type.
    return _enclosing_hull(np.asarray(points, dtype=float).tobytes(), settings).copy()


@lru_cache(maxsize=256)
def _enclosing_hull(corners: bytes, settings: HullSettings) -> Array:
    """Return the vertices around corners (n, 3), to be copied; kept, since cells that are checked share most parts."""
    points = np.frombuffer(corners).reshape(-1, 3)
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
    """Move each vertex (m, 3) half as far as its faces cut off points (n, 3), along normals; deep cuts count most."""
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
