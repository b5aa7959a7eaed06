"""The compiled collision kernel: which of a list of shape pairs comes closer than its margin.

A `CollisionKernel` is a tuple of arrays, made by `CollisionModel.scene`, that other compiled code can take, copy and
ask. Frames are numbered: 0 is the world, 1 + 7 k + i is frame i of arm k (0 base, 6 flange), the rest are movable.

Pairs are culled by bounding spheres, then by one sphere against the other's box, then by the axis that parted them
last time; what is left goes to GJK (`planners.collision.distance`). A pair that GJK cannot resolve collides.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from planners.collision.distance import Cores, PairIndices, core_bounds, face_gap, relative_transform
from planners.geometry.pose import Array, Transform
from planners.kinematics.forward import link_frames

RIGID, UPRIGHT = 0, 1
"""How a movable frame follows its parent: rigidly, or with a point of it and the axes of the world."""
STILL = 6
"""Column of `Scratch.travel` that is always zero."""
CONTACT = 1e-9
"""Shapes this close touch [m]: beyond rounding, below anything physical."""
MIN_TRAVEL = 1e-4
"""An interval of an edge that no point travels farther in than this, and still not proven free, collides [m]."""
MAX_DEPTH = 24
"""Most halvings of an edge."""


class CollisionKernel(NamedTuple):
    """Everything a query needs: shapes, arms, placements, pairs. Indices are int32, numbers float64."""

    cores: Cores
    radius: Array
    """(s,), what grows each shape."""
    spheres: Array
    """(s, 4), centre in the frame of the shape and radius of a ball around it (its growth included)."""
    boxes: Array
    """(s, 6), centre and half extents, along the axes of its frame, of a box around its core."""
    shape_frame: PairIndices
    """(s,)"""
    dh: Array
    """(arms, 6, 4)"""
    T_world_base: Array
    """(arms, 4, 4)"""
    arm_used: PairIndices
    """(arms,), 1 where a pair depends on this arm."""
    followers: PairIndices
    """(m, 3), movable frames in an order that has parents first: frame, parent, RIGID or UPRIGHT."""
    T_parent_follower: Array
    """(m, 4, 4), for UPRIGHT the last column is the point followed."""
    shapes: PairIndices
    """Shapes that some pair names."""
    drivers: PairIndices
    """(s, 3): arm that moves the shape (-1: none), how many of its joints do, 1 if it only translates."""
    pairs: PairIndices
    """(p, 4): shapes a and b, and the columns of `Scratch.travel` whose sum bounds their relative motion."""
    reach: Array
    """(p,): bounding spheres farther apart than this are farther apart than the margin [m]."""
    margin: Array
    """(p, 2): a sample keeps more than the first [m], the motion in between more than the second."""


class Scratch(NamedTuple):
    """Work space of one thread. `axis` remembers separating directions; the rest is rewritten by every query."""

    frames: Array
    """(frames, 4, 4), T_world_frame."""
    centers: Array
    """(s, 3), centres of the bounding spheres in the world."""
    axis: Array
    """(p, 3), direction in a's frame from a to b that parted a pair last; zero: none yet."""
    T_a_b: Array
    simplex: Array
    travel: Array
    """(s, 7): column i bounds how far a point of the shape moves against frame i of its arm."""
    stamp: PairIndices
    """(s,): the last interval that `centers` and `travel` of a shape were computed for."""


@njit(cache=True, nogil=True)
def make_scratch(kernel: CollisionKernel) -> Scratch:
    """Return fresh work space for queries of this kernel."""
    n_shapes, n_pairs = len(kernel.radius), len(kernel.pairs)
    # Frames whose bodies are not there keep their numbers.
    frames = np.zeros((max(1 + 7 * len(kernel.dh), kernel.shape_frame.max() + 1), 4, 4))
    for i in range(len(frames)):
        for k in range(4):
            frames[i, k, k] = 1.0
    for arm in range(len(kernel.dh)):
        frames[1 + 7 * arm] = kernel.T_world_base[arm]
    return Scratch(
        frames,
        np.empty((n_shapes, 3)),
        np.zeros((n_pairs, 3)),
        np.empty((3, 4)),
        np.empty((4, 3)),
        np.zeros((n_shapes, 7)),
        np.zeros(n_shapes, np.int32),
    )


@njit(cache=True, nogil=True)
def set_frame(kernel: CollisionKernel, frame: int, T_parent_frame: Transform) -> None:
    """Overwrite where a movable frame stands in its parent (the world, for a Fixed one), for loops over poses.

    Use it on a copy that no other thread reads (`CollisionQuery.kernel_copy`).

    Raises:
        ValueError: the frame is not a movable one that is placed in this scene.
    """
    for row in range(len(kernel.followers)):
        if kernel.followers[row, 0] == frame:
            kernel.T_parent_follower[row] = T_parent_frame
            return
    raise ValueError("not a frame placed in this scene")


@njit(cache=True, nogil=True)
def place_frames(kernel: CollisionKernel, q: Array, frames: Array) -> None:
    """Write `T_world_frame` of the frames that pairs depend on, at the joint positions q (6 per arm) [rad]."""
    for arm in range(len(kernel.dh)):
        if kernel.arm_used[arm]:
            first = 1 + 7 * arm
            link_frames(kernel.dh[arm], kernel.T_world_base[arm], q[6 * arm : 6 * arm + 6], frames[first : first + 7])
    _place_followers(kernel.followers, kernel.T_parent_follower, frames)


@njit(cache=True, nogil=True)
def _place_followers(followers: PairIndices, T_parent_follower: Array, frames: Array) -> None:
    for row in range(len(followers)):
        child, parent = followers[row, 0], followers[row, 1]
        rigid = followers[row, 2] == RIGID
        x, y, z = T_parent_follower[row, 0, 3], T_parent_follower[row, 1, 3], T_parent_follower[row, 2, 3]
        for i in range(3):
            px, py, pz = frames[parent, i, 0], frames[parent, i, 1], frames[parent, i, 2]
            frames[child, i, 3] = px * x + py * y + pz * z + frames[parent, i, 3]
            if rigid:
                for j in range(3):
                    frames[child, i, j] = (
                        px * T_parent_follower[row, 0, j]
                        + py * T_parent_follower[row, 1, j]
                        + pz * T_parent_follower[row, 2, j]
                    )


@njit(cache=True, nogil=True)
def place_center(spheres: Array, shape_frame: PairIndices, frames: Array, shape: int, centers: Array) -> None:
    """Write the centre, a row of `centers` (s, 3), of a shape's bounding sphere in the world [m]."""
    f = shape_frame[shape]
    x, y, z = spheres[shape, 0], spheres[shape, 1], spheres[shape, 2]
    for i in range(3):
        centers[shape, i] = frames[f, i, 0] * x + frames[f, i, 1] * y + frames[f, i, 2] * z + frames[f, i, 3]


@njit(cache=True, nogil=True)
def square_to_box(frames: Array, f: int, boxes: Array, shape: int, centers: Array, other: int) -> float:
    """Return the squared distance from the centre of another shape's sphere to the box of a shape in frame f [m2]."""
    x = centers[other, 0] - frames[f, 0, 3]
    y = centers[other, 1] - frames[f, 1, 3]
    z = centers[other, 2] - frames[f, 2, 3]
    square = 0.0
    for k in range(3):
        local = frames[f, 0, k] * x + frames[f, 1, k] * y + frames[f, 2, k] * z
        outside = abs(local - boxes[shape, k]) - boxes[shape, 3 + k]
        if outside > 0.0:
            square += outside * outside
    return square


@njit(cache=True, nogil=True)
def core_gap(kernel: CollisionKernel, pair: int, near: float, far: float, scratch: Scratch) -> float:
    """Return a lower bound on the distance of a pair's cores, sharp enough to compare with `near` and `far`.

    The frames and centres of both shapes are in place. Where `near` is negative the bound may be too: the cores then
    overlap by no more than its size.
    """
    # One width of integers, so that what follows is compiled once.
    a, b = int(np.int64(kernel.pairs[pair, 0])), int(np.int64(kernel.pairs[pair, 1]))
    f, g = int(np.int64(kernel.shape_frame[a])), int(np.int64(kernel.shape_frame[b]))
    _start_axis(scratch.axis, pair, scratch.centers, a, b, scratch.frames, f)
    relative_transform(scratch.frames, f, g, scratch.T_a_b)
    axis = scratch.axis[pair]
    lower, _ = core_bounds(kernel.cores, a, b, scratch.T_a_b, near, far, axis, scratch.simplex)
    if near < 0.0 and lower <= far:
        lower = face_gap(kernel.cores, a, b, scratch.T_a_b, lower, far, axis)
    return lower


@njit(cache=True, nogil=True)
def _start_axis(axis: Array, pair: int, centers: Array, a: int, b: int, frames: Array, f: int) -> None:
    """Start with the direction between the centres where no separating axis of a pair is known yet."""
    if axis[pair, 0] != 0.0 or axis[pair, 1] != 0.0 or axis[pair, 2] != 0.0:
        return
    x = centers[b, 0] - centers[a, 0]
    y = centers[b, 1] - centers[a, 1]
    z = centers[b, 2] - centers[a, 2]
    length = math.sqrt(x * x + y * y + z * z)
    if length < CONTACT:
        axis[pair, 0] = 1.0
        return
    for k in range(3):
        axis[pair, k] = (frames[f, 0, k] * x + frames[f, 1, k] * y + frames[f, 2, k] * z) / length


@njit(cache=True, nogil=True)
def first_collision(kernel: CollisionKernel, q: Array, scratch: Scratch) -> int:
    """Return the first pair of the kernel that is within its margin at q (6 per arm) [rad], or -1."""
    place_frames(kernel, q, scratch.frames)
    # Fields are taken out of the tuples once: inside the loop that would cost more than the tests.
    frames, centers = scratch.frames, scratch.centers
    spheres, boxes, radius, shape_frame = kernel.spheres, kernel.boxes, kernel.radius, kernel.shape_frame
    shapes, pairs, margin, reach = kernel.shapes, kernel.pairs, kernel.margin, kernel.reach
    for i in range(len(shapes)):
        place_center(spheres, shape_frame, frames, shapes[i], centers)
    for pair in range(len(pairs)):
        a, b = pairs[pair, 0], pairs[pair, 1]
        x = centers[a, 0] - centers[b, 0]
        y = centers[a, 1] - centers[b, 1]
        z = centers[a, 2] - centers[b, 2]
        if x * x + y * y + z * z > reach[pair] * reach[pair]:
            continue
        f, g = int(shape_frame[a]), int(shape_frame[b])
        threshold = margin[pair, 0]
        apart = spheres[a, 3] + radius[b] + threshold
        if square_to_box(frames, g, boxes, b, centers, a) > apart * apart:
            continue
        apart = spheres[b, 3] + radius[a] + threshold
        if square_to_box(frames, f, boxes, a, centers, b) > apart * apart:
            continue
        threshold += radius[a] + radius[b] + CONTACT
        if core_gap(kernel, pair, threshold, threshold, scratch) <= threshold:
            return pair
    return -1


@njit(cache=True, nogil=True)
def first_collisions(kernel: CollisionKernel, Q: Array) -> PairIndices:
    """Return `first_collision` of each row of Q (n, 6 per arm)."""
    scratch = make_scratch(kernel)
    found = np.empty(len(Q), np.int32)
    for i in range(len(Q)):
        found[i] = first_collision(kernel, Q[i], scratch)
    return found
