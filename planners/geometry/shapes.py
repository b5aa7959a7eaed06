"""Constructors of convex shapes. Where a round thing is drawn with flats, it lies inside its drawing."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy.optimize import nnls
from scipy.spatial import ConvexHull, QhullError

from planners.geometry.convex import ConvexShape
from planners.geometry.pose import Array

MAX_VERTICES = 60
"""Support queries walk all vertices; more of them cost time and change one verdict in four hundred."""


def sphere(center: Sequence[float] | Array, radius: float) -> ConvexShape:
    """Return the ball about `center` [m]."""
    return ConvexShape(np.asarray(center, dtype=float).reshape(1, 3), radius)


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
    angles = 2.0 * math.pi * np.arange(sides) / sides
    rim = radius / math.cos(math.pi / sides)
    return prism(rim * np.column_stack([np.cos(angles), np.sin(angles)]), height)


def convex_hull(points: Array, max_vertices: int = MAX_VERTICES) -> ConvexShape:
    """Return a shape around all `points` (n, 3) with at most `max_vertices` vertices.

    When the hull has more, those that matter most are kept and the shape grows by the largest distance a dropped
    one lies outside, so that nothing is left uncovered.
    """
    cloud = np.asarray(points, dtype=float)
    try:
        corners = cloud[ConvexHull(cloud).vertices]
    except QhullError:
        # Flat or thin: qhull has no volume to wrap, and the points themselves span the same hull.
        corners = np.unique(cloud, axis=0)
    if len(corners) <= max_vertices:
        return ConvexShape(corners)
    return _pruned(corners, max_vertices)


def _pruned(corners: Array, max_vertices: int) -> ConvexShape:
    """Grow a hull from a tetrahedron by the corner farthest outside it, until it has enough vertices."""
    kept = _spread_tetrahedron(corners)
    while True:
        planes = ConvexHull(corners[kept]).equations
        outside = (corners @ planes[:, :3].T + planes[:, 3]).max(axis=1)
        if len(kept) == max_vertices:
            return ConvexShape(corners[kept], _farthest_from_hull(corners, corners[kept]))
        kept.append(int(np.argmax(outside)))


def _spread_tetrahedron(corners: Array) -> list[int]:
    """Pick four corners that span a volume: each one farthest from what the earlier ones span."""
    first = int(np.argmin(corners[:, 0]))
    offsets = corners - corners[first]
    second = int(np.argmax(np.linalg.norm(offsets, axis=1)))
    along = offsets[second] / np.linalg.norm(offsets[second])
    across = offsets - np.outer(offsets @ along, along)
    third = int(np.argmax(np.linalg.norm(across, axis=1)))
    normal = np.cross(along, across[third] / np.linalg.norm(across[third]))
    return [first, second, third, int(np.argmax(np.abs(offsets @ normal)))]


def _farthest_from_hull(corners: Array, hull: Array) -> float:
    """Bound the largest distance of any corner from the convex hull of others from above [m]."""
    farthest = 0.0
    # Minimise |hull.T w - corner| over w >= 0; the heavy last row asks for sum(w) = 1.
    weight = 1e3 * float(np.ptp(hull, axis=0).max())
    system = np.vstack([hull.T, np.full(len(hull), weight)])
    for corner in corners:
        weights, _ = nnls(system, np.append(corner, weight))
        nearest = weights @ hull / weights.sum()
        farthest = max(farthest, float(np.linalg.norm(nearest - corner)))
    return farthest
