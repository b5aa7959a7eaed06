"""How far apart two convex solids are: along the best direction that can be found, or all along along one direction."""

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
) -> tuple[float, Array]:
    """Return the gap between the hulls of two sets of points along a way, or along a better one [m], and that way.

    The way is a unit vector of the world; zero where none was found, which the gap then tells as minus infinity.

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
    direction, nearest, between, along = np.empty(3), np.empty(3), np.empty(3), np.zeros(3)
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
        if gap > best:
            best, along[:] = gap, direction
        # At first what is told of how far they are apart, then the nearest difference found.
        if best >= _CLOSE_ENOUGH * (length - grown) - _FINE:
            break
        if step == 0:
            nearest[:] = between
        else:
            _move_towards(nearest, between)
        way, grown = nearest, radii
    return best, along


@njit(cache=True, nogil=True)
def gaps_along(direction: Array, points_a: Array, poses_a: Array, points_b: Array, poses_b: Array) -> Array:
    """Return the gaps between the hulls of two sets of points along one direction, at every pose of them: (n,) [m].

    Args:
        direction: (3,) unit, from a to b, in the frame that the poses are in.
        points_a: (k, 3) in a's frame [m].
        poses_a: (n, 4, 4), or (1, 4, 4) of what does not move.
        points_b: (m, 3) in b's frame [m].
        poses_b: as of a.
    """
    count = max(len(poses_a), len(poses_b))
    gaps = np.empty(count)
    end_a, end_b = 0.0, 0.0
    for n in range(count):
        if n < len(poses_a):
            end_a = _end(points_a, poses_a[n], direction, 1.0)
        if n < len(poses_b):
            end_b = _end(points_b, poses_b[n], direction, -1.0)
        gaps[n] = -end_b - end_a
    return gaps


@njit(cache=True, nogil=True)
def _end(points: Array, T: Transform, direction: Array, sign: float) -> float:
    """Return how far points reach along a direction, or against it [m]."""
    farthest = points[_farthest(points, T, direction, sign)]
    reach = 0.0
    for i in range(3):
        reach += direction[i] * (T[i, 0] * farthest[0] + T[i, 1] * farthest[1] + T[i, 2] * farthest[2] + T[i, 3])
    return sign * reach


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
