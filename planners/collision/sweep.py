"""Continuous queries: is a straight joint motion free of collision, everywhere and not only at samples?

Adaptive bisection after Schwarzer, Saha, Latombe, "Exact collision checking of robot paths" (2002): at the middle
of an interval each pair has a lower bound on its distance, and the joints' steps bound how far its two shapes can
move against each other until the ends. Where the bound is larger than the motion the pair is done with this
interval; the others are handed to both halves.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from planners.collision.kernel import (
    CONTACT,
    MAX_DEPTH,
    MIN_TRAVEL,
    CollisionKernel,
    Scratch,
    _core_bounds,
    _place_center,
    _sphere_misses_box,
    first_collision,
    make_scratch,
    place_frames,
)
from planners.geometry.pose import Array

CLEAR, UNDECIDED, COLLIDES = 0, 1, 2


@njit(cache=True, nogil=True)
def _bound_travel(kernel: CollisionKernel, shape: int, steps: Array, scratch: Scratch) -> None:
    """Bound how far any point of a shape moves against each frame of its arm while the joints turn by `steps`.

    A point at distance r from the axis of joint k moves r |step| when joint k turns; meanwhile the joints after k
    change r by no more than they move the point. So the bounds add up from the last joint inwards. The steps are
    those to either side of the interval's middle, where the frames are [rad].
    """
    arm = kernel.drivers[shape, 0]
    if arm < 0:
        return
    joints = kernel.drivers[shape, 1]
    radius = kernel.spheres[shape, 3]
    x, y, z = scratch.centers[shape, 0], scratch.centers[shape, 1], scratch.centers[shape, 2]
    if kernel.drivers[shape, 2]:
        # It only translates: all its points move as the origin of its frame does.
        T = scratch.frames[kernel.shape_frame[shape]]
        x, y, z, radius = T[0, 3], T[1, 3], T[2, 3], 0.0
    total = 0.0
    for joint in range(joints - 1, -1, -1):
        T = scratch.frames[1 + 7 * arm + joint]
        rx, ry, rz = x - T[0, 3], y - T[1, 3], z - T[2, 3]
        ax, ay, az = T[0, 2], T[1, 2], T[2, 2]
        cx, cy, cz = ay * rz - az * ry, az * rx - ax * rz, ax * ry - ay * rx
        distance = math.sqrt(cx * cx + cy * cy + cz * cz) + radius
        total += (distance + total) * steps[6 * arm + joint]
        scratch.travel[shape, joint] = total


@njit(cache=True, nogil=True)
def _prepare(kernel: CollisionKernel, shape: int, steps: Array, stamp: int, scratch: Scratch) -> None:
    """Bring centre and travel of a shape up to date, once an interval."""
    if scratch.stamp[shape] != stamp:
        scratch.stamp[shape] = stamp
        _place_center(kernel, shape, scratch)
        _bound_travel(kernel, shape, steps, scratch)


@njit(cache=True, nogil=True)
def _judge(kernel: CollisionKernel, pair: int, scratch: Scratch) -> int:
    """Say what the middle of an interval tells about a pair in the whole of it."""
    a, b = kernel.pairs[pair, 0], kernel.pairs[pair, 1]
    motion = scratch.travel[a, kernel.pairs[pair, 2]] + scratch.travel[b, kernel.pairs[pair, 3]]
    margin = kernel.margin[pair, 0]
    clear = max(margin, kernel.margin[pair, 1] + motion)
    x = scratch.centers[a, 0] - scratch.centers[b, 0]
    y = scratch.centers[a, 1] - scratch.centers[b, 1]
    z = scratch.centers[a, 2] - scratch.centers[b, 2]
    apart = kernel.spheres[a, 3] + kernel.spheres[b, 3] + clear
    if x * x + y * y + z * z > apart * apart:
        return CLEAR
    if _sphere_misses_box(kernel, a, b, clear, scratch) or _sphere_misses_box(kernel, b, a, clear, scratch):
        return CLEAR
    radii = kernel.radius[a] + kernel.radius[b] + CONTACT
    lower, upper = _core_bounds(kernel, pair, radii + margin, radii + clear, scratch)
    if lower > radii + clear:
        return CLEAR
    if lower <= radii + margin or motion <= MIN_TRAVEL:
        return COLLIDES
    return UNDECIDED


@njit(cache=True, nogil=True)
def _sweep(kernel: CollisionKernel, q_from: Array, q_to: Array, scratch: Scratch) -> tuple[int, float]:
    """Return the pair that keeps the open interval from being proven free, and where; (-1, 1.0) if it is free."""
    n = len(q_from)
    q, steps = np.empty(n), np.empty(n)
    pending = np.empty((MAX_DEPTH + 1, len(kernel.pairs)), np.int32)
    counts = np.zeros(MAX_DEPTH + 1, np.int64)
    for pair in range(len(kernel.pairs)):
        if kernel.pairs[pair, 2] != 6 or kernel.pairs[pair, 3] != 6:
            pending[0, counts[0]] = pair
            counts[0] += 1
    scratch.stamp[:] = -1
    depth, index, stamp = 0, 0, 0
    while True:
        half = 0.5 ** (depth + 1)
        middle = (2 * index + 1) * half
        for k in range(n):
            q[k] = q_from[k] + middle * (q_to[k] - q_from[k])
            steps[k] = half * abs(q_to[k] - q_from[k])
        place_frames(kernel, q, scratch.frames)
        stamp += 1
        left = 0
        for i in range(counts[depth]):
            pair = pending[depth, i]
            _prepare(kernel, kernel.pairs[pair, 0], steps, stamp, scratch)
            _prepare(kernel, kernel.pairs[pair, 1], steps, stamp, scratch)
            verdict = _judge(kernel, pair, scratch)
            if verdict == COLLIDES or (verdict == UNDECIDED and depth == MAX_DEPTH - 1):
                return pair, middle
            if verdict == UNDECIDED:
                pending[depth + 1, left] = pair
                left += 1
        if left:
            counts[depth + 1] = left
            depth, index = depth + 1, 2 * index
            continue
        while index % 2 == 1:
            depth, index = depth - 1, index // 2
        if depth == 0:
            return -1, 1.0
        index += 1


@njit(cache=True, nogil=True)
def edge_collision(kernel: CollisionKernel, q_from: Array, q_to: Array, scratch: Scratch) -> tuple[int, float]:
    """Check the straight joint motion between two configurations, its ends included.

    Every configuration that is looked at keeps the margins, and between them no pair comes closer than contact (than
    its margin, where that is negative), whatever the joints do on the way. What cannot be shown free collides.

    Returns:
        (pair, fraction): the pair in the way and where that was noticed (not always the first such place), or
        (-1, 1.0).
    """
    pair = first_collision(kernel, q_to, scratch)
    if pair >= 0:
        return pair, 1.0
    pair = first_collision(kernel, q_from, scratch)
    if pair >= 0:
        return pair, 0.0
    return _sweep(kernel, q_from, q_to, scratch)


@njit(cache=True, nogil=True)
def path_collision(kernel: CollisionKernel, Q: Array, scratch: Scratch) -> tuple[int, int, float]:
    """Check a polyline Q (n, 6 per arm) like `edge_collision`: all its corners first, then between them.

    Returns:
        (pair, k, fraction): the place is `Q[k] + fraction (Q[k + 1] - Q[k])`; or (-1, n - 1, 0.0).
    """
    for k in range(len(Q)):
        pair = first_collision(kernel, Q[k], scratch)
        if pair >= 0:
            return pair, k, 0.0
    for k in range(len(Q) - 1):
        pair, fraction = _sweep(kernel, Q[k], Q[k + 1], scratch)
        if pair >= 0:
            return pair, k, fraction
    return -1, len(Q) - 1, 0.0


@njit(cache=True, nogil=True)
def sweep_edge(kernel: CollisionKernel, q_from: Array, q_to: Array) -> tuple[int, float]:
    """Ask `edge_collision` with work space of its own."""
    return edge_collision(kernel, q_from, q_to, make_scratch(kernel))


@njit(cache=True, nogil=True)
def sweep_path(kernel: CollisionKernel, Q: Array) -> tuple[int, int, float]:
    """Ask `path_collision` with work space of its own."""
    return path_collision(kernel, Q, make_scratch(kernel))
