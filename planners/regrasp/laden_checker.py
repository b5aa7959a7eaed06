"""Edges of an arm that carries the tool: free of collision, about level, and borne by joints, fingers and cup."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

from planners.geometry.pose import Array
from planners.motion.checker import EdgeChecker
from planners.regrasp.bearing import CarryingHand
from planners.regrasp.joint_torque import LadenArm

STEP = 0.05
"""Joint step between the places of an edge at which the load is looked at [rad]: it is no matter of collision."""


@dataclass(frozen=True, eq=False)
class LadenChecker:
    """An `EdgeChecker` that also bounds the tilt of the tool, and asks whether the load is borne at rest."""

    inner: EdgeChecker
    hand: CarryingHand
    least_cosine: float
    """Of the angle between the tool's axis and the vertical."""
    arm: LadenArm
    """The same arm, with the same load."""
    most_torque: float
    """Part of each joint's largest torque that may be used [1]."""

    def state_free(self, q: Array) -> bool:
        """Whether q (6,) [rad] is level enough, borne, and touches nothing."""
        return self._borne(q, q) and self.inner.state_free(q)

    def edge_free(self, q_from: Array, q_to: Array) -> bool:
        """Whether all of the straight line between q_from and q_to (6,) [rad] is so."""
        return self._borne(q_from, q_to) and self.inner.edge_free(q_from, q_to)

    def path_free(self, path: Array) -> bool:
        """Whether all of the polyline through the rows of path (m, 6) [rad] is so."""
        return all(self._borne(a, b) for a, b in pairwise(path)) and self.inner.path_free(path)

    def _borne(self, q_from: Array, q_to: Array) -> bool:
        held = self.hand.bears(q_from, q_to, STEP, self.least_cosine)
        return held and self.arm.largest_share(q_from, q_to, STEP) <= self.most_torque
