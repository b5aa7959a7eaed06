"""Rotations that take a set of points to itself."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.spatial import KDTree

from planners.geometry.pose import Array, frame_from_z


def rotations(points: Array, tolerance: float) -> Array:
    """Return the rotations (k, 3, 3) about the mean of (n, 3) points that take each point to a point, identity first.

    A rotation is known from where it takes two points; it can only take them to points as far from the middle and
    from one another. The rotations of a round set without corners are not found.

    Args:
        points: not all on one line with their mean [m].
        tolerance: how far from a point one may end [m].
    """
    offsets = points - points.mean(axis=0)
    reach = np.linalg.norm(offsets, axis=1)
    first = int(np.argmax(reach))
    second = _partner(offsets, first)
    base = _frame(offsets[first], offsets[second])
    tree = KDTree(offsets)
    found = [np.eye(3)]
    for one, other in _images(offsets, reach, first, second, tolerance):
        R = _frame(offsets[one], offsets[other]) @ base.T
        if float(np.abs(R - np.eye(3)).max()) * reach[first] <= tolerance:
            continue
        distances, targets = tree.query(offsets @ R.T)
        if distances.max() <= tolerance and len(np.unique(targets)) == len(offsets):
            found.append(R)
    return np.array(found)


def _partner(offsets: Array, first: int) -> int:
    """Return the number of the point nearest the first one that, seen from the middle, is well off its direction."""
    away = np.linalg.norm(offsets - offsets[first], axis=1)
    along = offsets[first] / np.linalg.norm(offsets[first])
    across = np.linalg.norm(offsets - np.outer(offsets @ along, along), axis=1)
    return int(np.argmin(np.where(across >= 0.1 * across.max(), away, np.inf)))


def _images(offsets: Array, reach: Array, first: int, second: int, tolerance: float) -> Iterator[tuple[int, int]]:
    """Yield the numbers of the points that a symmetry may take the two points to."""
    apart = float(np.linalg.norm(offsets[first] - offsets[second]))
    slack = 2.0 * tolerance
    for one in np.flatnonzero(np.abs(reach - reach[first]) <= slack):
        away = np.linalg.norm(offsets - offsets[one], axis=1)
        fits = (np.abs(away - apart) <= slack) & (np.abs(reach - reach[second]) <= slack)
        yield from ((int(one), int(other)) for other in np.flatnonzero(fits))


def _frame(a: Array, b: Array) -> Array:
    return frame_from_z(a, b)
