"""A layer of the regrasp graph: the grasps that can have the tool at one pose, asked only as far as it matters."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from planners.geometry.pose import Array, Transform
from planners.regrasp.grasps.grasp_reach import REACH_FAULTS, TOUCHING, Branches, GraspReach, ReachFault
from planners.regrasp.motion.travel_time import solutions
from planners.regrasp.statics.hold_statics import OVERLOADED, UNGRIPPED
from planners.regrasp.statics.laden_arm import OVERTAXED, bearing_branches
from planners.regrasp.statics.static_hold import CarriedLoad, StaticHold
from planners.regrasp.tool_segment import SuckedObject

NodeMask = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class LayerLoad:
    """What hangs on the tool in a layer."""

    static_hold: StaticHold
    carried: CarriedLoad
    riding: Mapping[str, Transform]
    """`T_tool_object` of the object on the cup, by name; empty without one."""
    torque_reserve: float
    """Part of each joint's largest torque that is kept back."""

    @classmethod
    def of(cls, static_hold: StaticHold, sucked: SuckedObject | None, torque_reserve: float) -> LayerLoad:
        """Return the load of the tool with an object, or alone."""
        riding = {} if sucked is None else {sucked.name: sucked.T_tool_object}
        return cls(static_hold, static_hold.load(sucked), riding, torque_reserve)


class GraspLayer:
    """Branches on which each grasp of each arm can have the tool at a pose, and take it along a straight way there.

    Nodes are numbered as in the regrasp graph: the grasps of the left arm, then those of the right.
    """

    def __init__(self, T_world_tool: Transform, reach: Mapping[str, GraspReach], way: Array, load: LayerLoad) -> None:
        """Ask nothing yet.

        Args:
            T_world_tool: where the tool is.
            reach: of each arm.
            way: (3,) the straight way of the tool from there [m].
            load: what hangs on the tool.
        """
        self.T_world_tool, self._reach, self._way, self._load = T_world_tool, reach, way, load
        first = next(iter(reach.values()))
        self.count = len(first.grasps)
        nodes = self.count * len(reach)
        self.branches: Branches = np.zeros(nodes, np.uint8)
        self._faults = np.zeros(nodes, np.uint8)
        self._known = np.zeros(nodes, dtype=bool)
        self._overtaxed = np.zeros(nodes, dtype=bool)

    @property
    def reached(self) -> NodeMask:
        """(2 n,) the nodes that were asked and found possible."""
        return self.branches > 0

    @cached_property
    def holds(self) -> NodeMask:
        """(2 n,) the nodes in which fingers and hand bear tool and object, wherever the arm is."""
        return self._borne & self._carried

    @property
    def asked(self) -> int:
        """How many nodes were asked."""
        return int(self._known.sum())

    def ask(self, nodes: NodeMask) -> NodeMask:
        """Find out about nodes (2 n,), as far as that is not known; return those of them that are possible."""
        for number, reach in enumerate(self._reach.values()):
            part = slice(number * self.count, (number + 1) * self.count)
            chosen = np.flatnonzero(nodes[part] & ~self._known[part] & self.holds[part])
            if len(chosen):
                found = reach.reached(self.T_world_tool, self._way, chosen, self._load.riding)
                borne = bearing_branches(
                    reach.workcell.arm(reach.arm), self.T_world_tool, reach.T_tool_flange, self._load.carried,
                    found.branches, self._load.torque_reserve,
                )  # fmt: skip
                self.branches[part][chosen] = borne[chosen]
                self._overtaxed[part][chosen] = (found.branches[chosen] > 0) & (borne[chosen] == 0)
                self._faults[part][chosen] = found.faults[chosen]
                self.__dict__.pop("solutions", None)
        self._known |= nodes
        return nodes & self.reached

    def rejected(self) -> dict[str, NodeMask]:
        """Return why nodes that were asked are not possible: (2 n,) by reason."""
        masks: dict[str, NodeMask] = {UNGRIPPED: self._known & ~self._borne, OVERLOADED: self._known & ~self._carried}
        masks[OVERTAXED] = self._overtaxed
        for number, fault in enumerate(REACH_FAULTS, start=1):
            masks[fault.value] = self._faults == number
        return {reason: mask for reason, mask in masks.items() if mask.any()}

    @property
    def object_name(self) -> str:
        """Of what is on the cup; "the object" where nothing is."""
        return next(iter(self._load.riding), "the object")

    def hindrance(self) -> str:
        """Say for a person what keeps most nodes that were asked away, of a layer without a possible one.

        What is in the way of a grasp in reach comes before being out of reach: it is nearer to success.
        """
        counts = {reason: int(mask.sum()) for reason, mask in self.rejected().items()}
        if not counts:
            return "no hand could get hold of it"
        far = counts.get(ReachFault.AWAY.value, 0)
        touch = self._in_the_way()
        if touch is not None:
            return f"{' and '.join(touch)} would touch{', and no other grasp is in reach' if far else ''}"
        most = max(counts, key=counts.__getitem__)
        if most != ReachFault.AWAY.value:
            return most
        arms = [
            arm for arm, faults in zip(self._reach, self._faults.reshape(-1, self.count), strict=True) if faults.any()
        ]
        who = "neither arm reaches" if len(arms) > 1 else f"the {arms[0]} arm does not reach"
        return f"{who} all of the straight way to the tool there"

    def missing_squeeze(self) -> tuple[float, float] | None:
        """Return the least squeeze that any grasp asks for, and the one that fingers exert [N].

        None where some grasp is borne.
        """
        if self._borne.any():
            return None
        grasps = next(iter(self._reach.values())).grasps
        least = self._load.static_hold.least_squeezes(self._load.carried, grasps, self.T_world_tool)
        return float(least.min()), float(self._load.carried.fingers[0])

    def _in_the_way(self) -> tuple[str, str] | None:
        """Name two things that touch in one of the grasps that fell for it, of the arm with most of them."""
        touching = np.isin(self._faults, [1 + REACH_FAULTS.index(fault) for fault in TOUCHING]).reshape(-1, self.count)
        number = int(touching.sum(axis=1).argmax())
        fallen = np.flatnonzero(touching[number])
        if not len(fallen):
            return None
        reach = list(self._reach.values())[number]
        return reach.in_the_way(self.T_world_tool, self._way, int(fallen[len(fallen) // 2]), self._load.riding)

    @cached_property
    def _borne(self) -> NodeMask:
        """(2 n,) whether the fingers bear tool and object at rest there."""
        grasps = next(iter(self._reach.values())).grasps
        borne = self._load.static_hold.borne(self._load.carried, grasps, self.T_world_tool[None])[0]
        return np.tile(borne, len(self._reach))

    @cached_property
    def _carried(self) -> NodeMask:
        """(2 n,) whether the hand may carry tool and object."""
        carried = self._load.static_hold.carried(self._load.carried)
        return np.repeat([carried[arm] for arm in self._reach], self.count)

    @cached_property
    def solutions(self) -> Array:
        """(2 n, 8, 6) joint positions on the branches found, NaN elsewhere [rad]."""
        parts = []
        for number, reach in enumerate(self._reach.values()):
            branches = self.branches[number * self.count : (number + 1) * self.count]
            arm = reach.workcell.arm(reach.arm)
            parts.append(solutions(arm, self.T_world_tool, reach.T_tool_flange, branches))
        return np.concatenate(parts)
