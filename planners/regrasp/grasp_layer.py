"""A layer of the regrasp graph: the grasps that can have the tool at one pose, asked only as far as it matters."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from planners.geometry.pose import Array, Transform
from planners.regrasp.grasp_reach import Branches, GraspReach
from planners.regrasp.travel import least_travel, solutions

NodeMask = NDArray[np.bool_]


class GraspLayer:
    """Branches on which each grasp of each arm can have the tool at a pose, and take it along a straight way there.

    Nodes are numbered as in the regrasp graph: the grasps of the left arm, then those of the right.
    """

    def __init__(
        self, T_world_tool: Transform, ways: tuple[tuple[Mapping[str, GraspReach], Array | None], ...]
    ) -> None:
        """Ask nothing yet.

        Args:
            T_world_tool: where the tool is.
            ways: all of which a branch has to pass: each arm's reach, and the straight way of the tool (3,) [m].
        """
        self.T_world_tool, self._ways = T_world_tool, ways
        self._reach = ways[0][0]
        first = next(iter(self._reach.values()))
        self.count = len(first.grasps)
        self.branches: Branches = np.zeros(self.count * len(self._reach), np.uint8)
        self._known = np.zeros(len(self.branches), dtype=bool)

    @property
    def reached(self) -> NodeMask:
        """(2 n,) the nodes that were asked and found possible."""
        return self.branches > 0

    @property
    def asked(self) -> int:
        """How many nodes were asked."""
        return int(self._known.sum())

    def ask(self, nodes: NodeMask) -> NodeMask:
        """Find out about nodes (2 n,), as far as that is not known; return those of them that are possible."""
        for number, arm in enumerate(self._reach):
            part = slice(number * self.count, (number + 1) * self.count)
            chosen = np.flatnonzero(nodes[part] & ~self._known[part])
            if len(chosen):
                self.branches[part] |= self._asked(arm, chosen)
                self._known[part][chosen] = True
                self.__dict__.pop("solutions", None)
        return nodes & self.reached

    def _asked(self, arm: str, chosen: NDArray[np.int64]) -> Branches:
        found = np.zeros(self.count, np.uint8)
        found[chosen] = 0xFF
        for reach, way in self._ways:
            found &= reach[arm].branches(self.T_world_tool, way, chosen)
            chosen = np.flatnonzero(found)
        return found

    @cached_property
    def solutions(self) -> Array:
        """(2 n, 8, 6) joint positions on the branches found, NaN elsewhere [rad]."""
        parts = []
        for number, reach in enumerate(self._reach.values()):
            branches = self.branches[number * self.count : (number + 1) * self.count]
            arm = reach.workcell.arm(reach.arm)
            parts.append(solutions(arm, self.T_world_tool, reach.T_tool_flange, branches))
        return np.concatenate(parts)

    def travel_from(self, other: Array) -> Array:
        """Return (2 n,) least seconds from joint positions (2 n, k, 6) of the same nodes [rad]."""
        parts = []
        for number, reach in enumerate(self._reach.values()):
            part = slice(number * self.count, (number + 1) * self.count)
            parts.append(least_travel(reach.workcell.arm(reach.arm), other[part], self.solutions[part]))
        return np.concatenate(parts)
