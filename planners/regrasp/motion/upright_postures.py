"""Postures in which the tool is about upright, and so its load level, drawn between the ends of a motion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from planners.cell.arm import Arm
from planners.geometry.pose import Array, Transform, inverse
from planners.kinematics.forward import flange_poses
from planners.kinematics.inverse import BRANCHES, inverse_kinematics


@dataclass(frozen=True)
class UprightPostureSettings:
    """Where postures are drawn."""

    places: int = 64
    """Of the tool."""
    branches: int = 3
    """Of the arm's postures at a place, so many that are nearest to a straight motion are taken."""
    goals: int = 6
    """The first so many are gone towards."""
    aside: float = 0.3
    """How far beside the straight way a place is at most, and how far above it, as a share of the arm's reach [1]."""
    turned: float = np.pi / 2
    """How far the tool is turned about the vertical at most, from how it would be on a straight way [rad]."""


@dataclass(frozen=True, eq=False)
class UprightPostures:
    """Draws postures of an arm whose tool is turned no other way than on a straight motion, but for the vertical."""

    arm: Arm
    T_flange_tool: Transform
    least_cosine: float
    """Of the angle between the tool's axis and the vertical."""
    settings: UprightPostureSettings = UprightPostureSettings()

    def drawn(self, start: Array, goals: Array, rng: np.random.Generator) -> Array:
        """Return postures (m, 6) within the joints' ranges, between a start (6,) and some of the goals (k, 6) [rad]."""
        arm, settings = self.arm, self.settings
        count = settings.places
        towards, part = rng.integers(min(len(goals), settings.goals), size=count), rng.uniform(size=count)
        ends = flange_poses(arm.dh, arm.T_world_base, np.vstack([start, goals])) @ self.T_flange_tool
        first, last = ends[0], ends[1 + towards]
        aside = settings.aside * arm.robot.reach
        T_world_tools = np.tile(np.eye(4), (count, 1, 1))
        offsets = rng.uniform([-aside, -aside, 0.0], [aside, aside, aside], (count, 3))
        T_world_tools[:, :3, 3] = first[:3, 3] + part[:, None] * (last[:, :3, 3] - first[:3, 3]) + offsets
        begun = Rotation.from_matrix(first[:3, :3])
        between = begun * Rotation.from_rotvec(
            part[:, None] * (begun.inv() * Rotation.from_matrix(last[:, :3, :3])).as_rotvec()
        )
        yaw = Rotation.from_rotvec(rng.uniform(-settings.turned, settings.turned, (count, 1)) * [0.0, 0.0, 1.0])
        T_world_tools[:, :3, :3] = (yaw * between).as_matrix()
        T_base_flanges = inverse(arm.T_world_base) @ T_world_tools @ inverse(self.T_flange_tool)
        near = start + part[:, None] * (goals[towards] - start)
        limits = (arm.position_min, arm.position_max)
        found = _postures(arm.dh, np.ascontiguousarray(T_base_flanges), near, *limits)
        far = np.abs(found - near[:, None]).max(axis=2)
        nearest = np.argsort(far, axis=1)[:, : settings.branches]
        chosen = np.isfinite(np.take_along_axis(far, nearest, axis=1))
        return np.take_along_axis(found, nearest[:, :, None], axis=1)[chosen]

    def fits(self, Q: Array) -> NDArray[np.bool_]:
        """Say (m,) in which of the postures Q (m, 6) [rad] the tool is upright enough."""
        poses = flange_poses(self.arm.dh, self.arm.T_world_base, np.ascontiguousarray(Q))
        return poses[:, 2, :3] @ self.T_flange_tool[:3, 2] >= self.least_cosine


@njit(cache=True, nogil=True)
def _postures(dh, T_base_flanges, near, low, high):
    """Return all branches' postures (n, 8, 6) at poses (n, 4, 4), by whole turns near `near` (n, 6); inf for none."""
    turn = 2.0 * np.pi
    result, solutions = np.full((len(T_base_flanges), BRANCHES, 6), np.inf), np.empty((BRANCHES, 6))
    for pose in range(len(T_base_flanges)):
        valid = inverse_kinematics(dh, T_base_flanges[pose], near[pose, 5], solutions)
        for branch in range(BRANCHES):
            fits = (valid >> branch) & 1 == 1
            for i in range(6):
                q = solutions[branch, i]
                q += turn * np.round((near[pose, i] - q) / turn)
                if q < low[i]:
                    q += turn
                elif q > high[i]:
                    q -= turn
                fits = fits and low[i] <= q <= high[i]
                solutions[branch, i] = q
            if fits:
                result[pose, branch] = solutions[branch]
    return result
