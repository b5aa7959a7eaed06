"""How long an arm takes from one pose of the tool to another, in the best pair of branches (compiled).

What it carries has a pace of its own, on paths of the joints too.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numba import njit

from planners.cell.arm import Arm
from planners.geometry.pose import Array, Transform, inverse
from planners.kinematics.forward import flange_poses, link_frames
from planners.kinematics.inverse import inverse_kinematics, multiply
from planners.kinematics.windings import wrap
from planners.motion.path import JointPath
from planners.motion.timing import RateLimit
from planners.regrasp.grasps.grasp_reach import Branches
from planners.regrasp.tool_settings import CarriedPace

_CHORDS, _CHORD = 6, 0.5
"""The way of what is carried is measured along at least so many chords, each of at most so large joint steps [rad]."""
EFFORT = 0.15
"""Part of the time of each joint that counts beside the slowest: none turns for nothing while another takes longer."""


def solutions(arm: Arm, T_world_tool: Transform, T_tool_flange: Array, branches: Branches) -> Array:
    """Return joint positions (n, 8, 6) of grasps (n, 4, 4) at a pose of the tool; NaN where not in `branches` (n,)."""
    return _solutions(arm.dh, inverse(arm.T_world_base) @ T_world_tool, T_tool_flange, branches)


def least_travel_time(
    arm: Arm,
    one: Array,
    other: Array,
    T_tool_flange: Array | None = None,
    pace: CarriedPace | None = None,
    beyond: Array | None = None,
) -> Array:
    """Return for each grasp the least time [s] between its solutions (n, k, 6) and (n, m, 6).

    Of all joints the slowest counts, at full speed; and what is carried, at its pace while the joints go straight. To
    that `EFFORT` of the time of every joint is added.
    Joints turn the shorter way round that their limits allow: this ranks grasps, it does not plan. Infinite where
    either has no solution.

    Args:
        arm: that moves.
        one: joint positions at one end, NaN where there is no solution [rad].
        other: joint positions at the other end.
        T_tool_flange: (n, 4, 4) of each grasp; None for an arm that carries nothing.
        pace: of what is carried.
        beyond: (n, m) seconds that are added for going on from each solution at the other end.
    """
    beyond = np.zeros(other.shape[:2]) if beyond is None else beyond
    if T_tool_flange is None or pace is None:
        return _least_travel_time(one, other, beyond, _joints(arm), arm.dh, np.empty((0, 3)), np.full(2, np.inf))
    lips = -np.einsum("nji,nj->ni", T_tool_flange[:, :3, :3], T_tool_flange[:, :3, 3])
    return _least_travel_time(one, other, beyond, _joints(arm), arm.dh, lips, np.array([pace.speed, pace.turn]))


def straight_times(
    arm: Arm, start: Array, goals: Array, T_tool_flange: Transform | None = None, pace: CarriedPace | None = None
) -> Array:
    """Return how long (k,) an arm takes straight from `start` (6,) to each of `goals` (k, 6) [s].

    See `least_travel_time`. Whole turns count here; accelerations do not.
    """
    if T_tool_flange is None or pace is None:
        seconds = np.abs((goals - start) / arm.velocity_max)
        return seconds.max(axis=1) + EFFORT * seconds.sum(axis=1)
    lip = -T_tool_flange[:3, :3].T @ T_tool_flange[:3, 3]
    return _straight_times(
        start, np.ascontiguousarray(goals), arm.velocity_max, arm.dh, lip, np.array([pace.speed, pace.turn])
    )


def _joints(arm: Arm) -> Array:
    """Return (3, 6) rows of most speed, least and most position."""
    return np.array([arm.velocity_max, arm.position_min, arm.position_max])


@njit(cache=True, nogil=True)
def _solutions(dh, T_base_tool, T_tool_flange, branches):
    count = T_tool_flange.shape[0]
    result = np.full((count, 8, 6), np.nan)
    T_base_flange, found = np.empty((4, 4)), np.empty((8, 6))
    for k in range(count):
        if branches[k] == 0:
            continue
        multiply(T_base_tool, T_tool_flange[k], T_base_flange)
        inverse_kinematics(dh, T_base_flange, 0.0, found)
        for branch in range(8):
            if (branches[k] >> branch) & 1:
                result[k, branch] = found[branch]
    return result


@njit(cache=True, nogil=True)
def _straight_times(start, goals, velocity, dh, lip, pace):
    result = np.empty(goals.shape[0])
    for k in range(goals.shape[0]):
        step = goals[k] - start
        seconds = np.abs(step) / velocity
        result[k] = max(seconds.max(), _carried(dh, start, step, lip, pace)) + EFFORT * seconds.sum()
    return result


@njit(cache=True, nogil=True)
def _least_travel_time(one, other, beyond, joints, dh, lips, pace):
    result = np.full(one.shape[0], np.inf)
    step = np.empty(6)
    for k in range(one.shape[0]):
        for a in range(one.shape[1]):
            if math.isnan(one[k, a, 0]):
                continue
            for b in range(other.shape[1]):
                if math.isnan(other[k, b, 0]):
                    continue
                longest, more = 0.0, beyond[k, b]
                for i in range(6):
                    step[i] = _turn(one[k, a, i], other[k, b, i], joints[1, i], joints[2, i])
                    seconds = abs(step[i]) / joints[0, i]
                    longest, more = max(longest, seconds), more + EFFORT * seconds
                if longest + more < result[k] and lips.shape[0] > 0:
                    longest = max(longest, _carried(dh, one[k, a], step, lips[k], pace))
                if longest + more < result[k]:
                    result[k] = longest + more
    return result


@njit(cache=True, nogil=True)
def _turn(start, end, low, high):
    """The shorter turn that leads to an angle and ends within limits; if neither way does, the shorter one.

    Where limits do not reach round to the start, which is an angle as well, it is taken a whole turn further.
    """
    if start < low:
        start += 2.0 * math.pi
    elif start > high:
        start -= 2.0 * math.pi
    step = wrap(end - start)
    other = step - math.copysign(2.0 * math.pi, step)
    within = low <= start + step <= high
    return other if not within and low <= start + other <= high else step


@njit(cache=True, nogil=True)
def _carried(dh, q, step, lip, pace):
    """Time [s] that a point (3,) of the flange frame and the flange's turn need from q (6,) to q + step."""
    frames, last = np.empty((7, 4, 4)), np.empty((4, 4))
    base = np.eye(4)
    way, angle = 0.0, 0.0
    chords = max(_CHORDS, int(np.abs(step).max() / _CHORD) + 1)
    for s in range(chords + 1):
        link_frames(dh, base, q + step * (s / chords), frames)
        if s > 0:
            moved, turned = 0.0, 0.0
            for i in range(3):
                shift = frames[6, i, 3] - last[i, 3]
                for j in range(3):
                    difference = frames[6, i, j] - last[i, j]
                    shift += difference * lip[j]
                    turned += difference**2
                moved += shift**2
            way += math.sqrt(moved)
            # |R_b - R_a| (Frobenius) is 2 sqrt(2) sin(angle / 2).
            angle += 2.0 * math.asin(min(1.0, math.sqrt(turned / 8.0)))
        last[:] = frames[6]
    return max(way / pace[0], angle / pace[1])


_DIFFERENCE = 1e-4
"""Step of the differences, as a part of the path's length."""


def carried_rates(
    path: JointPath, arm: Arm, columns: slice, points: Array, pace: CarriedPace
) -> tuple[RateLimit, RateLimit]:
    """Limit the speed of points (k, 3) in the arm's flange frame, and the flange's rate of turning, along a path.

    Args:
        path: of the joints.
        arm: that carries.
        columns: of the arm's joints among those of the path.
        points: such as centres of mass [m].
        pace: the limits.
    """
    last: tuple[Array, tuple[Transform, Transform, Array]] | None = None

    def ends(s: Array) -> tuple[Transform, Transform, Array]:
        # Both limits are asked for the same places, one after the other.
        nonlocal last
        if last is None or last[0] is not s:
            last = s, around(s)
        return last[1]

    def around(s: Array) -> tuple[Transform, Transform, Array]:
        low = np.maximum(s - _DIFFERENCE * path.length, 0.0)
        high = np.minimum(s + _DIFFERENCE * path.length, path.length)
        Q = path.evaluate(np.concatenate([low, high])).positions[:, columns]
        poses = flange_poses(arm.dh, arm.T_world_base, np.ascontiguousarray(Q))
        return poses[: len(s)], poses[len(s) :], high - low

    def speed(s: Array) -> Array:
        one, other, step = ends(s)
        moved = np.einsum("nij,kj->nki", other[:, :3, :3] - one[:, :3, :3], points)
        moved += (other[:, :3, 3] - one[:, :3, 3])[:, None]
        return np.linalg.norm(moved, axis=2).max(axis=1) / step

    def turn(s: Array) -> Array:
        one, other, step = ends(s)
        # |R_b - R_a| (Frobenius) is 2 sqrt(2) sin(angle / 2), and the angle is small here.
        return np.linalg.norm(other[:, :3, :3] - one[:, :3, :3], axis=(1, 2)) / (np.sqrt(2.0) * step)

    return RateLimit(speed, pace.speed), RateLimit(turn, pace.turn)


class NodeTravelTimes:
    """Least times of arms that carry the tool in each of n grasps: those of the left arm, then those of the right."""

    def __init__(self, arms: Sequence[Arm], T_tool_flange: Sequence[Array], pace: CarriedPace) -> None:
        """Take the arms, the poses (n, 4, 4) of their flanges in the tool's frame, and the pace of what is carried."""
        self._arms, self._T_tool_flange, self._pace = tuple(arms), tuple(T_tool_flange), pace

    def between(self, one: Array, other: Array, beyond: Array | None = None) -> Array:
        """Return (2 n,) least seconds between (2 n, k, 6) and (2 n, m, 6) [rad]; infinite where either is all NaN.

        `beyond` (2 n, m) seconds are added for going on from there.
        """
        parts = []
        for number, arm in enumerate(self._arms):
            T_tool_flange = self._T_tool_flange[number]
            part = slice(number * len(T_tool_flange), (number + 1) * len(T_tool_flange))
            on = None if beyond is None else beyond[part]
            parts.append(least_travel_time(arm, one[part], other[part], T_tool_flange, self._pace, on))
        return np.concatenate(parts)

    def of(self, node: int, one: Array, other: Array, *, carries: bool = True) -> float:
        """Return least seconds of one node between (k, 6) and (m, 6) [rad], with the tool in hand or without."""
        number, grasp = divmod(node, len(self._T_tool_flange[0]))
        flange = self._T_tool_flange[number][grasp : grasp + 1] if carries else None
        return float(least_travel_time(self._arms[number], one[None], other[None], flange, self._pace)[0])
