"""How fast what an arm carries moves along a path of its joints."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planners.cell.arm import Arm
from planners.geometry.pose import Array, Transform
from planners.kinematics.forward import flange_poses
from planners.motion.limits import RateLimit
from planners.motion.path import JointPath

_DIFFERENCE = 1e-4
"""Step of the differences, as a part of the path's length."""


@dataclass(frozen=True)
class CarriedPace:
    """How fast bodies in a hand move through free space; their contact forces are shown at samples of a plan only."""

    speed: float = 0.9
    """Of any centre of mass [m/s]: 10 mm between two samples, less a reserve."""
    turn: float = 3.2
    """Of any body [rad/s]: 2 degrees between two samples, less a reserve."""
    sample_step: float = 0.01
    """Longest time between samples [s]: half of what the plan document asks for, so that hands need not be slow."""


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

    def ends(s: Array) -> tuple[Transform, Transform, Array]:
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
