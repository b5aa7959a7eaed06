"""How deep convex shapes are in one another, and how far one has to go to be out of others."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from planners.collision.distance import distance
from planners.geometry.convex import ConvexShape
from planners.geometry.pose import Array

_IDENTITY = np.eye(4)
_NEAREST = 1e-6
"""A way out is found to so much [m]."""


def gap(a: Sequence[ConvexShape], b: Sequence[ConvexShape]) -> float:
    """Return how far two bodies are apart [m]; not above 0 where they touch or overlap."""
    return min(distance(s, _IDENTITY, t, _IDENTITY) for s in a for t in b)


def depth(a: Sequence[ConvexShape], b: Sequence[ConvexShape]) -> float:
    """Return how deep two bodies are in one another [m]: the shortest way out of the deepest of their shapes; or 0."""
    return max(_shape_depth(s, t) for s in a for t in b)


def _shape_depth(a: ConvexShape, b: ConvexShape) -> float:
    """Return the shortest way by which one convex shape gets out of another [m]: where their difference's hull ends."""
    apart = distance(a, _IDENTITY, b, _IDENTITY)
    if apart > 0.0:
        return 0.0
    differences = (b.vertices[:, None] - a.vertices[None]).reshape(-1, 3)
    try:
        inside = -float(ConvexHull(differences).equations[:, 3].max())
    except (QhullError, ValueError):
        inside = 0.0
    # Where the hulls themselves are apart, only what they are grown by overlaps.
    return a.radius + b.radius + inside if inside > 0.0 else -apart


def shortest_way_out(
    a: Sequence[ConvexShape], b: Sequence[ConvexShape], directions: Array, grain: float
) -> tuple[int, float] | None:
    """Return along which direction a body gets out of another soonest, and after how much [m].

    Of bodies of several shapes it may be another way that leads out, and not the shortest.

    Args:
        a: what moves.
        b: what it overlaps.
        directions: (n, 3), of length 1.
        grain: the way is a multiple of it, with which the bodies do not even touch [m].

    Returns:
        The row of `directions` and the way; None if there are none.
    """
    best: tuple[int, float] | None = None
    reach = [_way_past(a, b, along) for along in directions]
    # The nearest first: of all others it only has to be seen that they are no shorter.
    for row in sorted(range(len(directions)), key=reach.__getitem__):
        along, most = directions[row], reach[row]
        if best is None:
            steps = 1 + int(_first_clear(a, b, along, most) // grain)
        elif gap(_moved(a, (best[1] - grain) * along), b) <= 0.0:
            continue
        else:
            steps = 1 + int(_first_clear(a, b, along, best[1] - grain) // grain)
        while gap(_moved(a, steps * grain * along), b) <= 0.0:
            steps += 1
        if best is None or steps * grain < best[1]:
            best = row, steps * grain
    return best


def _first_clear(a: Sequence[ConvexShape], b: Sequence[ConvexShape], along: Array, clear: float) -> float:
    """Return a way that just leads out, and is no longer than one that does [m]; convex ones have but one."""
    inside = 0.0
    if gap(_moved(a, max(clear - _NEAREST, 0.0) * along), b) <= 0.0:
        return clear
    while clear - inside > _NEAREST:
        middle = 0.5 * (inside + clear)
        if gap(_moved(a, middle * along), b) > 0.0:
            clear = middle
        else:
            inside = middle
    return clear


def _way_past(a: Sequence[ConvexShape], b: Sequence[ConvexShape], along: Array) -> float:
    """Return the way after which a body is past another altogether [m]."""
    last = max(float((shape.vertices @ along).max()) + shape.radius for shape in b)
    return last - min(float((shape.vertices @ along).min()) - shape.radius for shape in a)


def _moved(shapes: Sequence[ConvexShape], by: Array) -> list[ConvexShape]:
    return [ConvexShape(shape.vertices + by, shape.radius) for shape in shapes]
