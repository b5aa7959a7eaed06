"""How far the joints have to go from one pose of the tool to another, in the best pair of branches (compiled)."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from planners.geometry.pose import Array, Transform, inverse
from planners.kinematics.branch import multiply
from planners.kinematics.inverse import inverse_kinematics
from planners.kinematics.windings import wrap
from planners.regrasp.grasp_reach import Branches
from planners.scene.arm import Arm


def solutions(arm: Arm, T_world_tool: Transform, T_tool_flange: Array, branches: Branches) -> Array:
    """Return joint positions (n, 8, 6) of grasps (n, 4, 4) at a pose of the tool; NaN where not in `branches` (n,)."""
    return _solutions(arm.dh, inverse(arm.T_world_base) @ T_world_tool, T_tool_flange, branches)


def least_travel(arm: Arm, one: Array, other: Array) -> Array:
    """Return for each grasp the least time [s] at full speed between its solutions (n, k, 6) and (n, m, 6).

    Of all joints the slowest counts. Joints turn the shorter way round, as if they had no limits: this ranks grasps, it
    does not plan. Infinite where either has no solution.
    """
    return _least_travel(one, other, arm.velocity_max)


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
def _least_travel(one, other, velocity):
    result = np.full(one.shape[0], np.inf)
    for k in range(one.shape[0]):
        for a in range(one.shape[1]):
            if math.isnan(one[k, a, 0]):
                continue
            for b in range(other.shape[1]):
                longest = 0.0
                for i in range(6):
                    longest = max(longest, abs(wrap(other[k, b, i] - one[k, a, i])) / velocity[i])
                if longest < result[k]:
                    result[k] = longest
    return result
