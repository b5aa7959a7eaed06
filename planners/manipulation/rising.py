"""Which hands can carry the plate straight up from where a plan ends: the cooperative lift that follows it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from planners.balance.balanced import Balanced
from planners.balance.contacts import GripContacts, PushContact
from planners.balance.solver import Balance
from planners.geometry.pose import Array
from planners.manipulation.graph import HandHold, ManipulationStateGraph
from planners.manipulation.hold_balance import HoldBalance
from planners.manipulation.reach import PairReach, PlateQuery


@dataclass(frozen=True, eq=False)
class RisingReach:
    """What is left of the hands' postures when the plate rises from each goal pose, sampled on the way up."""

    pair: PairReach
    grips: NDArray[np.uint64]
    """(poses, grips) bit sets of the postures that go all the way up; none where the pose is no goal."""
    pushes: NDArray[np.uint64]
    """(poses, pushes), likewise."""
    T_world_plates: dict[int, Array]
    """By goal pose: (k, 4, 4) on the way up."""
    balance: Balance
    """Program (5) with part of the cup's force kept back for the lifter's jerks."""
    contacts: tuple[Sequence[GripContacts], Sequence[PushContact]]
    """Of all grips and pushes."""

    @classmethod
    def find(
        cls, holds: HoldBalance, pair: PairReach, lifted: PlateQuery, heights: Sequence[float], reserved: Balance
    ) -> Self:
        """Follow every hold up from every goal pose.

        Args:
            holds: the poses, and all grips and pushes.
            pair: both hands.
            lifted: plate and cup against what stands in the cell.
            heights: (k,) rising, at which postures are looked at [m].
            reserved: program (5) with the cup's reserve taken off.
        """
        poses = holds.poses
        up = np.zeros((len(heights), 4, 4))
        up[:, 2, 3] = heights
        ways = {goal: poses.poses[goal].T_world_plate + up for goal in poses.goals}
        grips = np.zeros((len(poses.poses), pair.first.hold_count), np.uint64)
        pushes = np.zeros((len(poses.poses), pair.second.hold_count), np.uint64)
        for goal, way in ways.items():
            if (lifted.first_collisions(way) < 0).all():
                grips[goal] = np.bitwise_and.reduce(pair.first.postures(way, lambda done: None), axis=0)
                pushes[goal] = np.bitwise_and.reduce(pair.second.postures(way, lambda done: None), axis=0)
        return cls(pair, grips, pushes, ways, reserved, (holds.grips, holds.pushes))

    def choose_goals(self, graph: ManipulationStateGraph) -> None:
        """Take the nodes out of a graph's goals from which one of the hands cannot go up."""
        pose = graph.node_pose
        graph.goal[:] &= _goes_up(self.grips, graph.grips)[pose, graph.node_grip]
        graph.goal[:] &= _goes_up(self.pushes, graph.pushes)[pose, graph.node_push]

    def bears(self, pose: int, grip: HandHold, push: HandHold) -> bool:
        """Whether two hands bear the plate at a goal pose, the cup's reserve untouched, and both go up from there."""
        contacts = self.contacts[0][grip.index], self.contacts[1][push.index]
        rotation = self.T_world_plates[pose][0, :3, :3]
        answer = self.balance.solve(rotation, np.empty((0, 3)), *contacts)
        return isinstance(answer, Balanced) and self.together(pose, grip, push)

    def together(self, pose: int, grip: HandHold, push: HandHold) -> bool:
        """Whether any postures of both holds go up from a goal pose with the arms apart."""
        allowed = (
            int(self.grips[pose, grip.index]) & grip.postures,
            int(self.pushes[pose, push.index]) & push.postures,
        )
        if not all(allowed):
            return False
        return self.pair.compatible(self.T_world_plates[pose], (grip.index, push.index), allowed) is not None


def _goes_up(sets: NDArray[np.uint64], holds: tuple[HandHold, ...]) -> NDArray[np.bool_]:
    """(poses, 1 + holds), 0 for an absent hand: whether any posture of a hold goes up from a pose."""
    columns = [(sets[:, hold.index] & np.uint64(hold.postures)) != 0 for hold in holds]
    return np.column_stack([np.zeros(len(sets), bool), *columns])
