"""How long an arm takes from one pose of the tool to another, in the best pair of branches (compiled)."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from planners.geometry.pose import Array, Transform, inverse
from planners.kinematics.branch import multiply
from planners.kinematics.forward import link_frames
from planners.kinematics.inverse import inverse_kinematics
from planners.kinematics.windings import wrap
from planners.regrasp.carried import CarriedPace
from planners.regrasp.grasp_reach import Branches
from planners.scene.arm import Arm

_CHORDS = 6
"""The way of what is carried is measured along so many chords."""


def solutions(arm: Arm, T_world_tool: Transform, T_tool_flange: Array, branches: Branches) -> Array:
    """Return joint positions (n, 8, 6) of grasps (n, 4, 4) at a pose of the tool; NaN where not in `branches` (n,)."""
    return _solutions(arm.dh, inverse(arm.T_world_base) @ T_world_tool, T_tool_flange, branches)


def least_travel(
    arm: Arm, one: Array, other: Array, T_tool_flange: Array | None = None, pace: CarriedPace | None = None
) -> Array:
    """Return for each grasp the least time [s] between its solutions (n, k, 6) and (n, m, 6).

    Of all joints the slowest counts, at full speed; and what is carried, at its pace while the joints go straight.
    Joints turn the shorter way round, as if they had no limits: this ranks grasps, it does not plan. Infinite where
    either has no solution.

    Args:
        arm: that moves.
        one: joint positions at one end, NaN where there is no solution [rad].
        other: joint positions at the other end.
        T_tool_flange: (n, 4, 4) of each grasp; None for an arm that carries nothing.
        pace: of what is carried.
    """
    if T_tool_flange is None or pace is None:
        return _least_travel(one, other, arm.velocity_max, arm.dh, np.empty((0, 3)), np.inf, np.inf)
    lips = -np.einsum("nji,nj->ni", T_tool_flange[:, :3, :3], T_tool_flange[:, :3, 3])
    return _least_travel(one, other, arm.velocity_max, arm.dh, lips, pace.speed, pace.turn)


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
def _least_travel(one, other, velocity, dh, lips, speed, turn):
    result = np.full(one.shape[0], np.inf)
    step = np.empty(6)
    for k in range(one.shape[0]):
        for a in range(one.shape[1]):
            if math.isnan(one[k, a, 0]):
                continue
            for b in range(other.shape[1]):
                if math.isnan(other[k, b, 0]):
                    continue
                longest = 0.0
                for i in range(6):
                    step[i] = wrap(other[k, b, i] - one[k, a, i])
                    longest = max(longest, abs(step[i]) / velocity[i])
                if longest < result[k] and lips.shape[0] > 0:
                    longest = max(longest, _carried(dh, one[k, a], step, lips[k], speed, turn))
                if longest < result[k]:
                    result[k] = longest
    return result


@njit(cache=True, nogil=True)
def _carried(dh, q, step, lip, speed, turn):
    """Time [s] that a point (3,) of the flange frame and the flange's turn need from q (6,) to q + step."""
    frames, last = np.empty((7, 4, 4)), np.empty((4, 4))
    base = np.eye(4)
    way, angle = 0.0, 0.0
    for s in range(_CHORDS + 1):
        link_frames(dh, base, q + step * (s / _CHORDS), frames)
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
    return max(way / speed, angle / turn)
