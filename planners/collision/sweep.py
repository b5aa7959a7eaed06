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

from planners.collision.distance import PairIndices
from planners.collision.kernel import (
    CONTACT,
    MAX_DEPTH,
    MIN_TRAVEL,
    STILL,
    CollisionKernel,
    Scratch,
    core_gap,
    first_collision,
    make_scratch,
    place_center,
    place_frames,
    square_to_box,
)
from planners.geometry.pose import Array


@njit(cache=True, nogil=True)
def bound_travel(
    drivers: PairIndices,
    spheres: Array,
    shape_frame: PairIndices,
    shape: int,
    steps: Array,
    frames: Array,
    centers: Array,
    travel: Array,
) -> None:
    """Bound how far any point of a shape moves against each frame of its arm while the joints turn by `steps`.

    A point at distance r from the axis of joint k moves at most r |step| when that joint alone turns. Turning the
    joints one by one, those nearest the base first, each finds the point, seen from its axis, where it was in the
    middle of the interval: so r is taken there, and the bounds of the joints beyond a frame add up. The steps are
    those to either side of the middle, where the frames are [rad].
    """
    arm = drivers[shape, 0]
    if arm < 0:
        return
    radius = spheres[shape, 3]
    x, y, z = centers[shape, 0], centers[shape, 1], centers[shape, 2]
    if drivers[shape, 2]:
        # It only translates: all its points move as the origin of its frame does.
        f = shape_frame[shape]
        x, y, z, radius = frames[f, 0, 3], frames[f, 1, 3], frames[f, 2, 3], 0.0
    total = 0.0
    for joint in range(drivers[shape, 1] - 1, -1, -1):
        step = steps[6 * arm + joint]
        if step > 0.0:
            f = 1 + 7 * arm + joint
            rx, ry, rz = x - frames[f, 0, 3], y - frames[f, 1, 3], z - frames[f, 2, 3]
            ax, ay, az = frames[f, 0, 2], frames[f, 1, 2], frames[f, 2, 2]
            cx, cy, cz = ay * rz - az * ry, az * rx - ax * rz, ax * ry - ay * rx
            total += (math.sqrt(cx * cx + cy * cy + cz * cz) + radius) * step
        travel[shape, joint] = total


@njit(cache=True, nogil=True)
def _unproven(
    kernel: CollisionKernel,
    q: Array,
    steps: Array,
    stamp: int,
    pending: PairIndices,
    depth: int,
    count: int,
    scratch: Scratch,
) -> tuple[int, int]:
    """Look at the middle q of an interval of half-width `steps`, and keep the pairs that it does not clear.

    Args:
        kernel: the pairs.
        q: middle of the interval [rad].
        steps: (n,), how far each joint is from its ends [rad].
        stamp: a number that no earlier interval of this sweep had.
        pending: (depths, p); row `depth` holds the pairs to look at, those left are written to the next row.
        depth: halvings so far.
        count: how many pairs row `depth` holds.
        scratch: work space.

    Returns:
        (pair, left): the pair that collides, or -1, and the number of pairs left.
    """
    place_frames(kernel, q, scratch.frames)
    frames, centers = scratch.frames, scratch.centers
    travel, stamps = scratch.travel, scratch.stamp
    spheres, boxes, radius, shape_frame = kernel.spheres, kernel.boxes, kernel.radius, kernel.shape_frame
    drivers, pairs, margins = kernel.drivers, kernel.pairs, kernel.margin
    left = 0
    for i in range(count):
        pair = int(np.int64(pending[depth, i]))
        a, b = pairs[pair, 0], pairs[pair, 1]
        for k in range(2):
            shape = pairs[pair, k]
            if stamps[shape] != stamp:
                stamps[shape] = stamp
                place_center(spheres, shape_frame, frames, shape, centers)
                bound_travel(drivers, spheres, shape_frame, shape, steps, frames, centers, travel)
        motion = travel[a, pairs[pair, 2]] + travel[b, pairs[pair, 3]]
        margin = margins[pair, 0]
        clear = max(margin, margins[pair, 1] + motion)
        x = centers[a, 0] - centers[b, 0]
        y = centers[a, 1] - centers[b, 1]
        z = centers[a, 2] - centers[b, 2]
        apart = spheres[a, 3] + spheres[b, 3] + clear
        if x * x + y * y + z * z > apart * apart:
            continue
        f, g = int(shape_frame[a]), int(shape_frame[b])
        apart = spheres[a, 3] + radius[b] + clear
        if square_to_box(frames, g, boxes, b, centers, a) > apart * apart:
            continue
        apart = spheres[b, 3] + radius[a] + clear
        if square_to_box(frames, f, boxes, a, centers, b) > apart * apart:
            continue
        radii = radius[a] + radius[b] + CONTACT
        lower = core_gap(kernel, pair, radii + margin, radii + clear, scratch)
        if lower > radii + clear:
            continue
        if lower <= radii + margin or motion <= MIN_TRAVEL or depth == MAX_DEPTH - 1:
            return pair, 0
        pending[depth + 1, left] = pair
        left += 1
    return -1, left


@njit(cache=True, nogil=True)
def _sweep(kernel: CollisionKernel, q_from: Array, q_to: Array, scratch: Scratch) -> tuple[int, float]:
    """Return the pair that keeps the open interval from being proven free, and where; (-1, 1.0) if it is free."""
    n = len(q_from)
    q, steps = np.empty(n), np.empty(n)
    pending = np.empty((MAX_DEPTH + 1, len(kernel.pairs)), np.int32)
    counts = np.zeros(MAX_DEPTH + 1, np.int64)
    counts[0] = _moving_pairs(kernel.pairs, pending)
    scratch.stamp[:] = -1
    # Typed numbers: literal ones would have the rest compiled for them once more.
    depth, index, stamp = int(np.int64(0)), int(np.int64(0)), int(np.int64(0))
    while True:
        half = 0.5 ** (depth + 1)
        middle = (2 * index + 1) * half
        for k in range(n):
            q[k] = q_from[k] + middle * (q_to[k] - q_from[k])
            steps[k] = half * abs(q_to[k] - q_from[k])
        pair, left = _unproven(kernel, q, steps, stamp, pending, depth, counts[depth], scratch)
        stamp += 1
        if pair >= 0:
            return pair, middle
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
def _moving_pairs(pairs: PairIndices, pending: PairIndices) -> int:
    """Write the pairs whose shapes can move against each other into row 0 of (depths, p); return how many they are."""
    count = 0
    for pair in range(len(pairs)):
        if pairs[pair, 2] != STILL or pairs[pair, 3] != STILL:
            pending[0, count] = pair
            count += 1
    return count


@njit(cache=True, nogil=True)
def edge_collision(kernel: CollisionKernel, q_from: Array, q_to: Array) -> tuple[int, float]:
    """Check the straight joint motion between two configurations, its ends included.

    Every configuration that is looked at keeps the margins, and between them no pair comes closer than contact (than
    its margin, where that is negative), whatever the joints do on the way. What cannot be shown free collides.

    Returns:
        (pair, fraction): the pair in the way and where that was noticed (not always the first such place), or
        (-1, 1.0).
    """
    scratch = make_scratch(kernel)
    pair = first_collision(kernel, q_to, scratch)
    if pair >= 0:
        return pair, 1.0
    pair = first_collision(kernel, q_from, scratch)
    if pair >= 0:
        return pair, 0.0
    return _sweep(kernel, q_from, q_to, scratch)


@njit(cache=True, nogil=True)
def path_collision(kernel: CollisionKernel, Q: Array) -> tuple[int, int, float]:
    """Check a polyline Q (n, 6 per arm) like `edge_collision`: all its corners first, then between them.

    Returns:
        (pair, k, fraction): the place is `Q[k] + fraction (Q[k + 1] - Q[k])`; or (-1, n - 1, 0.0).
    """
    scratch = make_scratch(kernel)
    for k in range(len(Q)):
        pair = first_collision(kernel, Q[k], scratch)
        if pair >= 0:
            return pair, k, 0.0
    for k in range(len(Q) - 1):
        pair, fraction = _sweep(kernel, Q[k], Q[k + 1], scratch)
        if pair >= 0:
            return pair, k, fraction
    return -1, len(Q) - 1, 0.0
