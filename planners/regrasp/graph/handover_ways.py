"""Handovers as a planner of one object sees them: which the load allows, where both arms are, and how far away."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from planners.geometry.pose import Array
from planners.regrasp.grasps.handovers import HandoverDatabase
from planners.regrasp.motion.tool_exchange import HandoverPlace
from planners.regrasp.motion.travel_time import NodeTravelTimes, solutions
from planners.regrasp.statics.static_hold import StaticHold
from planners.regrasp.tool_segment import SuckedObject
from planners.regrasp.tool_workcell import ToolWorkcell

HandoverMasks = tuple[NDArray[np.bool_], NDArray[np.bool_]]
"""(n, n) whether the left arm's grasp [row] can be handed to the right arm's [column]; and right to left."""


class HandoverWays:
    """All handovers of a tool. Nodes are numbered as in the regrasp graph."""

    def __init__(
        self,
        handovers: HandoverDatabase,
        workcell: ToolWorkcell,
        static_hold: StaticHold,
        park: Mapping[str, Array],
        travel_times: NodeTravelTimes,
        most_tilt: float,
    ) -> None:
        """Take what all objects share.

        Args:
            handovers: of the cell and the tool.
            workcell: with the arms.
            static_hold: what cup and fingers hold.
            park: (6,) where each arm stands while the other moves [rad].
            travel_times: how long arms need.
            most_tilt: of the tool while an object hangs on it [rad].
        """
        self.handovers, self.workcell, self.travel_times = handovers, workcell, travel_times
        self._static_hold, self._park, self._most_tilt = static_hold, park, most_tilt
        self._masks: dict[bytes, HandoverMasks] = {}

    @cached_property
    def positions(self) -> Array:
        """(o, 2 n, 8, 6) of each node in each orientation of the tool, NaN on branches that do not reach it [rad]."""
        return np.stack([self._in_orientation(number) for number in range(len(self.handovers.T_world_tool))])

    @cached_property
    def receiving(self) -> Array:
        """(2 n,) least seconds an empty hand needs from where it is parked to a handover."""
        positions = self._by_node(self.positions)
        n = len(self.handovers.grasps)
        rests = [self._park[arm] for arm in self.workcell.cell.arms]
        of = self.travel_times.of
        return np.array([of(node, rests[node // n][None], q, carries=False) for node, q in enumerate(positions)])

    def masks(self, sucked: SuckedObject | None) -> HandoverMasks:
        """Return which grasps pass the tool on in any orientation in which cup and both hands bear it."""
        borne = self._borne(sucked)
        key = np.packbits(borne).tobytes()
        if key not in self._masks:
            some = borne.any(axis=1)
            base, held = self.handovers.compatible[some], borne[some]
            there = np.asarray((base & held[:, :, None] & held[:, None, :]).any(axis=0))
            self._masks[key] = (there, np.ascontiguousarray(there.T))
        return self._masks[key]

    def borne_positions(self, sucked: SuckedObject | None) -> Array:
        """Return (2 n, 8 o, 6) joint positions of each node in all orientations in which it bears the load [rad]."""
        borne = np.tile(self._borne(sucked), 2)
        return self._by_node(np.where(borne[:, :, None, None], self.positions, np.nan))

    def meetings(self, giver: int, receiver: int, sucked: SuckedObject | None) -> NDArray[np.int64]:
        """Return the orientations (k,) in which two nodes, of either arm, pass the tool on with its load."""
        arms, n = tuple(self.workcell.cell.arms), len(self.handovers.grasps)
        (giving, given), (taking, taken) = divmod(giver, n), divmod(receiver, n)
        numbers = self.handovers.orientations(arms[giving], given, arms[taking], taken)
        borne = self._borne(sucked)
        return numbers[borne[numbers, given] & borne[numbers, taken]]

    def places(
        self, q: Mapping[str, Array], giver: int, receiver: int, sucked: SuckedObject | None, ahead: Array
    ) -> list[HandoverPlace]:
        """Return where the tool can change hands, those with the shortest ways to them and on from there first.

        Args:
            q: (6,) where each arm is [rad].
            giver: node that has the tool.
            receiver: node that is to have it.
            sucked: the object on the cup.
            ahead: (k, 6) where the receiver goes next [rad].
        """
        arms, n = tuple(self.workcell.cell.arms), len(self.handovers.grasps)
        times = self.travel_times
        here, empty = q[arms[giver // n]][None], q[arms[receiver // n]][None]
        ranked = []
        for number in self.meetings(giver, receiver, sucked):
            give, take = self.positions[number, giver], self.positions[number, receiver]
            seconds = times.of(giver, here, give) + times.of(receiver, empty, take, carries=False)
            if len(ahead):
                seconds += times.of(receiver, take, ahead)
            ranked.append((seconds, int(number)))
        return [
            HandoverPlace(
                self.handovers.T_world_tool[number],
                int(self.handovers.reached(arms[giver // n])[number, giver % n]),
                int(self.handovers.reached(arms[receiver // n])[number, receiver % n]),
            )
            for _, number in sorted(ranked)
        ]

    def _in_orientation(self, number: int) -> Array:
        """Return (2 n, 8, 6)."""
        T_world_tool = self.handovers.T_world_tool[number]
        parts = []
        for name, T_tool_flange in self._T_tool_flanges.items():
            branches = self.handovers.reached(name)[number]
            parts.append(solutions(self.workcell.arm(name), T_world_tool, T_tool_flange, branches))
        return np.concatenate(parts)

    @cached_property
    def _T_tool_flanges(self) -> dict[str, Array]:
        """(n, 4, 4) the flange on the tool in each grasp, by arm."""
        grasps = self.handovers.grasps
        return {arm: grasps.T_tool_flange(self.workcell.gripper(arm)) for arm in self.workcell.cell.arms}

    def _by_node(self, positions: Array) -> Array:
        """Bring (o, 2 n, 8, 6) to (2 n, 8 o, 6)."""
        return np.ascontiguousarray(np.moveaxis(positions, 0, 1)).reshape(positions.shape[1], -1, 6)

    def _borne(self, sucked: SuckedObject | None) -> NDArray[np.bool_]:
        """Return (o, n) in which orientations cup and fingers bear the load in which grasp.

        Before and after a handover one hand carries all of it, so that either must be allowed to.
        """
        hold, poses = self._static_hold, self.handovers.T_world_tool
        load = hold.load(sucked)
        borne = hold.borne(load, self.handovers.grasps, poses) & all(hold.carried(load).values())
        if sucked is None:
            return borne
        level = poses[:, 2, 2] >= np.cos(self._most_tilt)
        return borne & (level & hold.hanging(load, poses))[:, None]


@dataclass(frozen=True, eq=False)
class LoadHandovers:
    """The handovers of one suction pose, by round: of the tool alone, and with the object. Found when asked for."""

    ways: HandoverWays
    sucked: SuckedObject

    @property
    def loads(self) -> tuple[SuckedObject | None, SuckedObject | None]:
        """What is on the cup in each round."""
        return (None, self.sucked)

    @cached_property
    def masks(self) -> tuple[HandoverMasks, HandoverMasks]:
        """Which grasps pass the tool on."""
        return (self.ways.masks(None), self.ways.masks(self.sucked))

    @cached_property
    def positions(self) -> tuple[Array, Array]:
        """(2 n, m, 6) joint positions of each node at handovers, NaN where it is at none [rad]."""
        return (self.ways.borne_positions(None), self.ways.borne_positions(self.sucked))

    def giver_positions(self, number: int, giver: int, receiver: int) -> Array:
        """Return (m, 6) where the giver is at the handovers of two nodes in a round [rad]."""
        return self.ways.positions[self.ways.meetings(giver, receiver, self.loads[number]), giver].reshape(-1, 6)
