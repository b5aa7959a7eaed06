"""Whether convex regions cover a convex polygon, whatever they are and however they overlap."""

from __future__ import annotations

import numpy as np

from planners.geometry.pose import Array


def uncovered_point(polygon: Array, regions: Array) -> Array | None:
    """Return a point of a polygon that no region contains, None if together they cover it.

    Region after region is cut off the polygon, each time one that the middle of what is left lies in: either such a
    middle is found in none, or in the end nothing is left. Exact but for rounding: regions that are to meet without a
    gap should overlap by a hair.

    Args:
        polygon: (k, d) corners in order, of a convex polygon in the plane or in space [m].
        regions: (n, f, d + 1) rows a, b of half-spaces a·x + b <= 0, which meet in a convex region each.

    Returns:
        (d,) [m].
    """
    left = [(polygon, regions)]
    while left:
        piece, regions = left.pop()
        heights = regions[:, :, :-1] @ piece.T + regions[:, :, -1:]
        near = ~np.any(np.all(heights > 0.0, axis=2), axis=1)
        regions, heights = regions[near], heights[near]
        middle = piece.mean(axis=0)
        around = np.flatnonzero(np.all(regions[:, :, :-1] @ middle + regions[:, :, -1] <= 0.0, axis=1))
        if len(around) == 0:
            return middle
        if np.any(np.all(heights[around] <= 0.0, axis=(1, 2))):
            continue
        cutting = around[0]
        others = np.delete(regions, cutting, axis=0)
        crossing = np.any(heights[cutting] > 0.0, axis=1)
        left += [(outside, others) for outside in _cut_off(piece, regions[cutting, crossing])]
    return None


def _cut_off(polygon: Array, planes: Array) -> list[Array]:
    """Return the convex pieces of a polygon that are outside a region, of which these planes cross the polygon."""
    pieces = []
    for plane in planes:
        heights = polygon @ plane[:-1] + plane[-1]
        if np.all(heights <= 0.0):
            continue
        pieces.append(_side(polygon, -heights))
        polygon = _side(polygon, heights)
    return pieces


def _side(polygon: Array, heights: Array) -> Array:
    """Return the part of a polygon where heights, given at its corners, are not positive."""
    next_heights = np.roll(heights, -1)
    crossing = (heights > 0.0) != (next_heights > 0.0)
    share = np.divide(heights, heights - next_heights, out=np.zeros_like(heights), where=crossing)
    between = polygon + share[:, None] * (np.roll(polygon, -1, axis=0) - polygon)
    kept = np.column_stack([heights <= 0.0, crossing]).ravel()
    return np.stack([polygon, between], axis=1).reshape(-1, polygon.shape[1])[kept]
