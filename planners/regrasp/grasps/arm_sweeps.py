"""Whether two arms that come and go by turns keep apart (compiled).

Each arm is followed along the way back from its grasp. One ball around all places of a shape on that way proves most
pairs of shapes apart at once; what it does not prove is looked at place by place.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from planners.collision.kernel import (
    CONTACT,
    CollisionKernel,
    Scratch,
    core_gap,
    make_scratch,
    place_center,
    square_to_box,
)
from planners.geometry.pose import Array, Transform
from planners.kinematics.forward import link_frames
from planners.kinematics.inverse import inverse_kinematics


class ArmSweep(NamedTuple):
    """An arm on the ways back from its grasps, on each branch that reaches them."""

    rows: NDArray[np.int64]
    """(n, 8) where the branch of a grasp is in `frames`; -1 where it is not reached."""
    frames: Array
    """(r, k, 7, 4, 4) `T_world_i` of the arm's frames at each place of the way, the grasp first."""


@njit(cache=True, nogil=True)
def sweep_arm(
    dh: Array,
    T_world_base: Transform,
    T_base_tool: Transform,
    T_tool_flange: Array,
    branches: NDArray[np.uint8],
    way: Array,
) -> ArmSweep:
    """Follow an arm back from its grasps (n, 4, 4) along the hand's z, for sets of branches (n,)."""
    count = T_tool_flange.shape[0]
    rows = np.full((count, 8), -1)
    total = 0
    for grasp in range(count):
        for branch in range(8):
            if (branches[grasp] >> branch) & 1:
                rows[grasp, branch] = total
                total += 1
    frames = np.empty((total, way.shape[0], 7, 4, 4))
    solutions = np.empty((8, 6))
    for grasp in range(count):
        if branches[grasp] == 0:
            continue
        T_contact = T_base_tool @ T_tool_flange[grasp]
        T = T_contact.copy()
        for k in range(way.shape[0]):
            for i in range(3):
                T[i, 3] = T_contact[i, 3] - way[k] * T_contact[i, 2]
            inverse_kinematics(dh, T, 0.0, solutions)
            for branch in range(8):
                if rows[grasp, branch] >= 0:
                    link_frames(dh, T_world_base, solutions[branch], frames[rows[grasp, branch], k])
    return ArmSweep(rows, frames)


@njit(cache=True, nogil=True)
def first_branches(
    kernel: CollisionKernel, pairs: NDArray[np.int64], first: ArmSweep, second: ArmSweep, codes: NDArray[np.uint8]
) -> None:
    """Write for pairs of grasps (m, 2) with which branches the arms keep apart while either comes and goes.

    Args:
        kernel: pairs of shapes of arm 0 and arm 1.
        pairs: grasp of arm 0, grasp of arm 1.
        first: arm 0.
        second: arm 1.
        codes: (n, n), written where there is a pair of branches: 1 + 8 branch of arm 0 + branch of arm 1.
    """
    scratch = make_scratch(kernel)
    near = np.empty(len(kernel.pairs), np.int64)
    balls = _sweep_balls(kernel, first.frames, 0), _sweep_balls(kernel, second.frames, 1)
    for pair in range(pairs.shape[0]):
        a, b = pairs[pair, 0], pairs[pair, 1]
        for one in range(8):
            for two in range(8):
                row, column = first.rows[a, one], second.rows[b, two]
                if codes[a, b] != 0 or row < 0 or column < 0:
                    continue
                _place_arm(scratch, 0, first.frames[row, 0])
                _place_arm(scratch, 1, second.frames[column, 0])
                count = _not_proven(kernel, scratch, balls[0][row], balls[1][column], near)
                if count == 0 or _apart(kernel, scratch, near[:count], first.frames[row], second.frames[column]):
                    codes[a, b] = 1 + 8 * one + two


@njit(cache=True, nogil=True)
def _sweep_balls(kernel: CollisionKernel, frames: Array, arm: int) -> Array:
    """Return for each row and shape the ball (r, s, 4) around all places of the shape; zero for the other arm's."""
    balls = np.zeros((frames.shape[0], len(kernel.radius), 4))
    last = frames.shape[1] - 1
    for shape in kernel.shapes:
        if kernel.drivers[shape, 0] != arm:
            continue
        frame = int(kernel.shape_frame[shape]) - 1 - 7 * arm
        local = kernel.spheres[shape]
        for row in range(frames.shape[0]):
            ball = balls[row, shape]
            for i in range(3):
                ball[i] = 0.5 * (
                    _coordinate(frames[row, 0, frame], local, i) + _coordinate(frames[row, last, frame], local, i)
                )
            for k in range(frames.shape[1]):
                square = 0.0
                for i in range(3):
                    square += (_coordinate(frames[row, k, frame], local, i) - ball[i]) ** 2
                ball[3] = max(ball[3], square)
            ball[3] = np.sqrt(ball[3]) + local[3]
    return balls


@njit(cache=True, nogil=True)
def _coordinate(T: Transform, point: Array, i: int) -> float:
    return T[i, 0] * point[0] + T[i, 1] * point[1] + T[i, 2] * point[2] + T[i, 3]


@njit(cache=True, nogil=True)
def _place_arm(scratch: Scratch, arm: int, frames: Array) -> None:
    for i in range(7):
        for j in range(3):
            for k in range(4):
                scratch.frames[1 + 7 * arm + i, j, k] = frames[i, j, k]


@njit(cache=True, nogil=True)
def _not_proven(kernel: CollisionKernel, scratch: Scratch, first: Array, second: Array, near: NDArray[np.int64]) -> int:
    """List the pairs of shapes that balls do not prove apart while one arm moves and the other is at its grasp."""
    count = 0
    for pair in range(len(kernel.pairs)):
        a, b = int(kernel.pairs[pair, 0]), int(kernel.pairs[pair, 1])
        if kernel.drivers[a, 0] == 1:
            a, b = b, a
        apart = first[a, 3] + second[b, 3] + kernel.margin[pair, 0]
        square = 0.0
        for i in range(3):
            square += (first[a, i] - second[b, i]) ** 2
        if square > apart * apart:
            continue
        margin = kernel.margin[pair, 0] + CONTACT
        to_second = first[a, 3] + kernel.radius[b] + margin
        to_first = second[b, 3] + kernel.radius[a] + margin
        f, g = int(kernel.shape_frame[a]), int(kernel.shape_frame[b])
        if (
            square_to_box(scratch.frames, g, kernel.boxes, b, first, a) <= to_second * to_second
            or square_to_box(scratch.frames, f, kernel.boxes, a, second, b) <= to_first * to_first
        ):
            near[count] = pair
            count += 1
    return count


@njit(cache=True, nogil=True)
def _apart(kernel: CollisionKernel, scratch: Scratch, near: NDArray[np.int64], first: Array, second: Array) -> bool:
    """Say whether pairs of shapes keep their margins with either arm on its way (k, 7, 4, 4), the other at its end."""
    for k in range(first.shape[0]):
        _place_arm(scratch, 0, first[k])
        _place_arm(scratch, 1, second[0])
        if not _margins_kept(kernel, scratch, near):
            return False
        _place_arm(scratch, 0, first[0])
        _place_arm(scratch, 1, second[k])
        if not _margins_kept(kernel, scratch, near):
            return False
    return True


@njit(cache=True, nogil=True)
def _margins_kept(kernel: CollisionKernel, scratch: Scratch, near: NDArray[np.int64]) -> bool:
    frames, centers = scratch.frames, scratch.centers
    for pair in near:
        a, b = int(kernel.pairs[pair, 0]), int(kernel.pairs[pair, 1])
        place_center(kernel.spheres, kernel.shape_frame, frames, a, centers)
        place_center(kernel.spheres, kernel.shape_frame, frames, b, centers)
        f, g = int(kernel.shape_frame[a]), int(kernel.shape_frame[b])
        margin = kernel.margin[pair, 0]
        apart = kernel.spheres[a, 3] + kernel.radius[b] + margin
        if square_to_box(frames, g, kernel.boxes, b, centers, a) > apart * apart:
            continue
        apart = kernel.spheres[b, 3] + kernel.radius[a] + margin
        if square_to_box(frames, f, kernel.boxes, a, centers, b) > apart * apart:
            continue
        threshold = margin + kernel.radius[a] + kernel.radius[b] + CONTACT
        if core_gap(kernel, pair, threshold, threshold, scratch) <= threshold:
            return False
    return True
