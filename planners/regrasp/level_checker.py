"""Free motion that keeps what hangs on the cup about level: tilted far, an object comes off it, or twists the tool."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from planners.geometry.pose import Array, Transform
from planners.kinematics.forward import flange_poses
from planners.motion.checker import EdgeChecker
from planners.scene.arm import Arm

STEP = 0.05
"""Joint step between the places of an edge at which the tilt is looked at [rad]: it is no matter of collision."""


@dataclass(frozen=True, eq=False)
class LevelChecker:
    """An `EdgeChecker` that also bounds the tilt of the tool, and asks whether the cup holds."""

    inner: EdgeChecker
    arm: Arm
    T_flange_tool: Transform
    least_cosine: float
    """Of the angle between the tool's axis and the vertical."""
    holds: Callable[[Array], bool]
    """Whether the cup holds at rest at all poses of the tool (n, 4, 4)."""

    def state_free(self, q: Array) -> bool:
        """Whether q (6,) [rad] is level enough and touches nothing."""
        return self._level(q[None]) and self.inner.state_free(q)

    def edge_free(self, q_from: Array, q_to: Array) -> bool:
        """Whether the straight line between q_from and q_to (6,) [rad] is level enough and touches nothing."""
        return self._level(_between(q_from, q_to)) and self.inner.edge_free(q_from, q_to)

    def path_free(self, path: Array) -> bool:
        """Whether the polyline through the rows of path (m, 6) [rad] is level enough and touches nothing."""
        return self._level(path) and self.inner.path_free(path)

    def _level(self, Q: Array) -> bool:
        poses = flange_poses(self.arm.dh, self.arm.T_world_base, np.ascontiguousarray(Q))
        tools = poses @ self.T_flange_tool
        return bool(tools[:, 2, 2].min() >= self.least_cosine) and self.holds(tools)


def _between(q_from: Array, q_to: Array) -> Array:
    count = 2 + int(np.abs(q_to - q_from).max() / STEP)
    return q_from + np.linspace(0.0, 1.0, count)[:, None] * (q_to - q_from)
