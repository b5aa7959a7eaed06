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
from numpy.typing import NDArray

from planners.collision.distance import core_bounds, relative_transform
from planners.geometry.pose import Array, Transform
from planners.kinematics.forward import link_frames

Indices = NDArray[np.int32]

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

    vertices: Array
    """(v, 3), all shapes' vertices, each in its own frame."""
    vertex_range: Indices
    """(s, 2), first vertex of a shape and end."""
    radius: Array
    """(s,), what grows each shape."""
    spheres: Array
    """(s, 4), centre in the frame of the shape and radius of a ball around it (its growth included)."""
    boxes: Array
    """(s, 6), centre and half extents, along the axes of its frame, of a box around its core."""
    shape_frame: Indices
    """(s,)"""
    dh: Array
    """(arms, 6, 4)"""
    T_world_base: Array
    """(arms, 4, 4)"""
    arm_used: Indices
    """(arms,), 1 where a pair depends on this arm."""
    followers: Indices
    """(m, 3), movable frames in an order that has parents first: frame, parent, RIGID or UPRIGHT."""
    T_parent_follower: Array
    """(m, 4, 4), for UPRIGHT the last column is the point followed."""
    shapes: Indices
    """Shapes that some pair names."""
    drivers: Indices
    """(s, 3): arm that moves the shape (-1: none), how many of its joints do, 1 if it only translates."""
    pairs: Indices
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
    stamp: Indices
    """(s,): the last interval that `centers` and `travel` of a shape were computed for."""


@njit(cache=True, nogil=True)
def make_scratch(kernel: CollisionKernel) -> Scratch:
    """Return fresh work space for queries of this kernel."""
    n_shapes, n_pairs = len(kernel.radius), len(kernel.pairs)
    frames = np.zeros((1 + 7 * len(kernel.dh) + len(kernel.followers), 4, 4))
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
    for row in range(len(kernel.followers)):
        out = frames[kernel.followers[row, 0]]
        parent = frames[kernel.followers[row, 1]]
        T = kernel.T_parent_follower[row]
        rigid = kernel.followers[row, 2] == RIGID
        for i in range(3):
            out[i, 3] = parent[i, 0] * T[0, 3] + parent[i, 1] * T[1, 3] + parent[i, 2] * T[2, 3] + parent[i, 3]
            for j in range(3):
                if rigid:
                    out[i, j] = parent[i, 0] * T[0, j] + parent[i, 1] * T[1, j] + parent[i, 2] * T[2, j]


@njit(cache=True, nogil=True)
def _place_center(kernel: CollisionKernel, shape: int, scratch: Scratch) -> None:
    T = scratch.frames[kernel.shape_frame[shape]]
    x, y, z = kernel.spheres[shape, 0], kernel.spheres[shape, 1], kernel.spheres[shape, 2]
    scratch.centers[shape, 0] = T[0, 0] * x + T[0, 1] * y + T[0, 2] * z + T[0, 3]
    scratch.centers[shape, 1] = T[1, 0] * x + T[1, 1] * y + T[1, 2] * z + T[1, 3]
    scratch.centers[shape, 2] = T[2, 0] * x + T[2, 1] * y + T[2, 2] * z + T[2, 3]


@njit(cache=True, nogil=True)
def _center_to_box(kernel: CollisionKernel, a: int, b: int, scratch: Scratch) -> float:
    """Return the distance from the centre of a's sphere to b's box [m]."""
    T = scratch.frames[kernel.shape_frame[b]]
    x = scratch.centers[a, 0] - T[0, 3]
    y = scratch.centers[a, 1] - T[1, 3]
    z = scratch.centers[a, 2] - T[2, 3]
    square = 0.0
    for k in range(3):
        local = T[0, k] * x + T[1, k] * y + T[2, k] * z
        outside = abs(local - kernel.boxes[b, k]) - kernel.boxes[b, 3 + k]
        if outside > 0.0:
            square += outside * outside
    return math.sqrt(square)


@njit(cache=True, nogil=True)
def _sphere_misses_box(kernel: CollisionKernel, a: int, b: int, clearance: float, scratch: Scratch) -> bool:
    """Say whether a's sphere and b's box prove a and b farther apart than `clearance` [m]."""
    return _center_to_box(kernel, a, b, scratch) > kernel.spheres[a, 3] + kernel.radius[b] + clearance


@njit(cache=True, nogil=True)
def _first_axis(kernel: CollisionKernel, pair: int, scratch: Scratch) -> None:
    """Start with the direction between the centres where no separating axis is known yet."""
    axis = scratch.axis[pair]
    if axis[0] != 0.0 or axis[1] != 0.0 or axis[2] != 0.0:
        return
    a, b = kernel.pairs[pair, 0], kernel.pairs[pair, 1]
    T = scratch.frames[kernel.shape_frame[a]]
    x = scratch.centers[b, 0] - scratch.centers[a, 0]
    y = scratch.centers[b, 1] - scratch.centers[a, 1]
    z = scratch.centers[b, 2] - scratch.centers[a, 2]
    length = math.sqrt(x * x + y * y + z * z)
    if length < CONTACT:
        axis[0] = 1.0
        return
    for k in range(3):
        axis[k] = (T[0, k] * x + T[1, k] * y + T[2, k] * z) / length


@njit(cache=True, nogil=True)
def _core_bounds(kernel: CollisionKernel, pair: int, near: float, far: float, scratch: Scratch) -> tuple[float, float]:
    """Bound the distance of a pair's cores; the frames and centres are in place."""
    a, b = kernel.pairs[pair, 0], kernel.pairs[pair, 1]
    _first_axis(kernel, pair, scratch)
    relative_transform(scratch.frames[kernel.shape_frame[a]], scratch.frames[kernel.shape_frame[b]], scratch.T_a_b)
    return core_bounds(
        kernel.vertices,
        kernel.vertex_range[a, 0],
        kernel.vertex_range[a, 1],
        kernel.vertex_range[b, 0],
        kernel.vertex_range[b, 1],
        scratch.T_a_b,
        near,
        far,
        scratch.axis[pair],
        scratch.simplex,
    )


@njit(cache=True, nogil=True)
def _collides(kernel: CollisionKernel, pair: int, scratch: Scratch) -> bool:
    """Say whether a pair is within its margin, or cannot be shown not to be."""
    a, b = kernel.pairs[pair, 0], kernel.pairs[pair, 1]
    x = scratch.centers[a, 0] - scratch.centers[b, 0]
    y = scratch.centers[a, 1] - scratch.centers[b, 1]
    z = scratch.centers[a, 2] - scratch.centers[b, 2]
    if x * x + y * y + z * z > kernel.reach[pair] * kernel.reach[pair]:
        return False
    margin = kernel.margin[pair, 0]
    if _sphere_misses_box(kernel, a, b, margin, scratch) or _sphere_misses_box(kernel, b, a, margin, scratch):
        return False
    threshold = kernel.radius[a] + kernel.radius[b] + margin + CONTACT
    lower, _ = _core_bounds(kernel, pair, threshold, threshold, scratch)
    return lower <= threshold


@njit(cache=True, nogil=True)
def first_collision(kernel: CollisionKernel, q: Array, scratch: Scratch) -> int:
    """Return the first pair of the kernel that is within its margin at q (6 per arm) [rad], or -1."""
    place_frames(kernel, q, scratch.frames)
    for i in range(len(kernel.shapes)):
        _place_center(kernel, kernel.shapes[i], scratch)
    for pair in range(len(kernel.pairs)):
        if _collides(kernel, pair, scratch):
            return pair
    return -1


@njit(cache=True, nogil=True)
def first_collisions(kernel: CollisionKernel, Q: Array) -> Indices:
    """Return `first_collision` of each row of Q (n, 6 per arm)."""
    scratch = make_scratch(kernel)
    found = np.empty(len(Q), np.int32)
    for i in range(len(Q)):
        found[i] = first_collision(kernel, Q[i], scratch)
    return found
