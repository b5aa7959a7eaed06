"""Convex polygons in the plane: counter-clockwise (n, 2) outlines in metres.

Side k of an outline runs from corner k to corner k + 1 (modulo n).
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numba import njit

from planners.errors import LiftwrightError
from planners.geometry.pose import Array

_MIN_SIDE = 1e-6
"""Shortest side that counts as one [m]."""
_MIN_TURN = 1e-6
"""Smallest sine of the turn at a corner: a straight corner is none."""
_ON_LINE = 1e-9
"""Distance within which a point is on a line [m]."""


class ShapeError(LiftwrightError):
    """A shape that cannot be what it is called."""


def convex_outline(corners: Sequence[Sequence[float]] | Array) -> Array:
    """Return the corners as a read-only (n, 2) array.

    Raises:
        ShapeError: unless they are at least three finite corners, counter-clockwise and strictly convex.
    """
    outline = np.array(corners, dtype=float)
    if outline.ndim != 2 or outline.shape[1] != 2 or len(outline) < 3 or not np.all(np.isfinite(outline)):
        raise ShapeError("an outline is a list of at least three finite [x, y] corners")
    sides = _sides(outline)
    lengths = np.linalg.norm(sides, axis=1)
    if np.any(lengths < _MIN_SIDE):
        raise ShapeError(f"corner {int(np.argmin(lengths))} of the outline coincides with the next one")
    directions = sides / lengths[:, None]
    before = np.roll(directions, 1, axis=0)
    turns = _cross(before, directions)
    if np.any(turns < _MIN_TURN):
        raise ShapeError(
            f"corner {int(np.argmin(turns))} of the outline does not turn left: "
            "an outline is strictly convex and counter-clockwise"
        )
    # Left turns everywhere still allow an outline that winds around twice.
    winding = float(np.sum(np.arctan2(turns, np.sum(before * directions, axis=1))))
    if winding > 3.0 * np.pi:
        raise ShapeError("the outline crosses itself")
    outline.flags.writeable = False
    return outline


def rectangle(x: float, y: float) -> Array:
    """Return the (4, 2) corners of a rectangle about the origin along the axes [m]; corner 0 is at -x, -y."""
    return 0.5 * np.array([[-x, -y], [x, -y], [x, y], [-x, y]])


def circle(radius: float, count: int) -> Array:
    """Return (count, 2) points on a circle about the origin [m]; point 0 is at +x."""
    angles = 2.0 * math.pi * np.arange(count) / count
    return radius * np.column_stack([np.cos(angles), np.sin(angles)])


def side_lengths(outline: Array) -> Array:
    """Return the (n,) lengths of the sides [m]."""
    return np.linalg.norm(_sides(outline), axis=1)


def side_directions(outline: Array) -> Array:
    """Return the (n, 2) unit vectors along the sides, counter-clockwise."""
    sides = _sides(outline)
    return sides / np.linalg.norm(sides, axis=1)[:, None]


def inward_normals(outline: Array) -> Array:
    """Return the (n, 2) unit normals of the sides that point into the polygon."""
    along = side_directions(outline)
    return np.stack([-along[:, 1], along[:, 0]], axis=1)


def area(outline: Array) -> float:
    """Return the area that an outline (n, 2) encloses [m²]."""
    x, y = outline[:, 0], outline[:, 1]
    return 0.5 * float(x[:-1] @ y[1:] - x[1:] @ y[:-1] + x[-1] * y[0] - x[0] * y[-1])


def segment_distance(one: Array, other: Array) -> float:
    """Return the distance between two straight segments that do not cross, each (2, 2) with its ends as rows [m]."""
    return min(
        _point_distance(point, segment) for point, segment in [(p, other) for p in one] + [(p, one) for p in other]
    )


def _point_distance(point: Array, segment: Array) -> float:
    way = segment[1] - segment[0]
    part = float(np.clip((point - segment[0]) @ way / (way @ way), 0.0, 1.0))
    return float(np.linalg.norm(point - segment[0] - part * way))


def centroid(outline: Array) -> Array:
    """Return the (2,) centroid of the enclosed area [m]."""
    following = np.roll(outline, -1, axis=0)
    weights = _cross(outline, following)
    return (outline + following).T @ weights / (3.0 * float(np.sum(weights)))


def depth_inside(outline: Array, points: Array) -> Array:
    """Return how deep (k, 2) points lie inside [m]: the distance to the nearest side's line, negative outside."""
    offsets = np.asarray(points, dtype=float)[:, None, :] - outline[None, :, :]
    return np.min(np.sum(offsets * inward_normals(outline)[None, :, :], axis=2), axis=1)


def overlap(outline: Array, other: Array) -> Array:
    """Return the corners (m, 2) of the intersection of two convex polygons, counter-clockwise; m is 0 when apart.

    Sutherland and Hodgman's clipping of the first outline by each side of the second.
    """
    # Copies: for arrays that are locked, or in another order, the kernel would be compiled once more.
    corners, sides = (np.array(each, dtype=float, order="C") for each in (outline, other))
    return _clipped(corners, sides)


@njit(cache=True, nogil=True)
def _clipped(corners: Array, sides: Array) -> Array:
    """Clip a polygon (n, 2) by each side of another (m, 2), and drop corners that coincide."""
    kept = corners
    for side in range(len(sides)):
        start, end = sides[side], sides[(side + 1) % len(sides)]
        x, y = end[0] - start[0], end[1] - start[1]
        length, heights = math.sqrt(x * x + y * y), np.empty(len(kept))
        if length == 0.0:
            continue
        for i in range(len(kept)):
            height = (x * (kept[i, 1] - start[1]) - y * (kept[i, 0] - start[0])) / length
            heights[i] = 0.0 if abs(height) < _ON_LINE else height
        if np.all(heights >= 0.0):
            continue
        left, count = np.empty((2 * len(kept), 2)), 0
        for i in range(len(kept)):
            following = (i + 1) % len(kept)
            here, there = heights[i], heights[following]
            if here >= 0.0:
                left[count] = kept[i]
                count += 1
            if here * there < 0.0:
                left[count] = kept[i] + here / (here - there) * (kept[following] - kept[i])
                count += 1
        kept = left[:count].copy()
    apart = np.empty(len(kept), np.bool_)
    for i in range(len(kept)):
        x, y = kept[i, 0] - kept[i - 1, 0], kept[i, 1] - kept[i - 1, 1]
        apart[i] = math.sqrt(x * x + y * y) > _MIN_SIDE
    return kept[apart]


def _sides(outline: Array) -> Array:
    """Return the (n, 2) ways from each corner to the next [m]."""
    return np.concatenate([outline[1:], outline[:1]]) - outline


def _cross(a: Array, b: Array) -> Array:
    """Return the z components (...) of the cross products of vectors (..., 2)."""
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
