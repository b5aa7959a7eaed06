"""How far apart two convex solids are along the best direction that can be found from a first one."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from planners.geometry.pose import Array, Transform

_CLOSE_ENOUGH, _FINE = 0.98, 1e-5
"""A gap of this part of the distance, less this length [m], is good enough: it only costs steps."""
_STEPS = 60


@njit(cache=True, nogil=True)
def largest_gap(
    way: Array, points_a: Array, T_world_a: Transform, points_b: Array, T_world_b: Transform, radii: float
) -> float:
    """Return the gap between the hulls of two sets of points along a way, or along better ones [m].

    Gilbert, Johnson and Keerthi's distance, 1988, in the simplest form, Gilbert's: of all differences between points
    of both, the nearest to the origin so far is moved towards the one that is farthest along the direction to it. The
    gap along any direction is a lower bound of the distance.

    Args:
        way: (3,) from a to b, in the world, not zero; as long as they seem to be apart [m].
        points_a: (k, 3) in a's frame [m].
        T_world_a: (4, 4).
        points_b: (m, 3) in b's frame [m].
        T_world_b: (4, 4).
        radii: by which both hulls together are grown [m].
    """
    direction, nearest, between = np.empty(3), np.empty(3), np.empty(3)
    best, grown = -math.inf, 0.0
    for step in range(_STEPS):
        length = math.sqrt(way[0] ** 2 + way[1] ** 2 + way[2] ** 2)
        if length == 0.0:
            break
        for i in range(3):
            direction[i] = way[i] / length
        a, b = _farthest(points_a, T_world_a, direction, 1.0), _farthest(points_b, T_world_b, direction, -1.0)
        gap = -radii
        for i in range(3):
            between[i] = T_world_b[i, 3] - T_world_a[i, 3]
            for j in range(3):
                between[i] += T_world_b[i, j] * points_b[b, j] - T_world_a[i, j] * points_a[a, j]
            gap += between[i] * direction[i]
        best = max(best, gap)
        # At first what is told of how far they are apart, then the nearest difference found.
        if best >= _CLOSE_ENOUGH * (length - grown) - _FINE:
            break
        if step == 0:
            nearest[:] = between
        else:
            _move_towards(nearest, between)
        way, grown = nearest, radii
    return best


@njit(cache=True, nogil=True)
def _farthest(points: Array, T_world_points: Transform, direction: Array, sign: float) -> int:
    """Return the number of the point that is farthest along a direction of the world, or against it."""
    local = np.zeros(3)
    for i in range(3):
        for j in range(3):
            local[j] += sign * direction[i] * T_world_points[i, j]
    found, most = 0, -math.inf
    for k in range(len(points)):
        reach = local[0] * points[k, 0] + local[1] * points[k, 1] + local[2] * points[k, 2]
        if reach > most:
            found, most = k, reach
    return found


@njit(cache=True, nogil=True)
def _move_towards(nearest: Array, other: Array) -> None:
    """Move a point to where the segment from it to another one is nearest to the origin, in place."""
    square, inner = 0.0, 0.0
    for i in range(3):
        square += (other[i] - nearest[i]) ** 2
        inner += nearest[i] * (other[i] - nearest[i])
    if square > 0.0:
        part = min(1.0, max(0.0, -inner / square))
        for i in range(3):
            nearest[i] += part * (other[i] - nearest[i])
