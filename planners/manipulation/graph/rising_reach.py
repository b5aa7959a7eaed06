"""Which hands can carry the plate straight up from where a plan ends: the cooperative lift that follows it."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy

import numpy as np

from planners.balance.balanced import Balanced
from planners.balance.solver import Balance
from planners.geometry.pose import Array
from planners.manipulation.graph.manipulation_graph import HandHold
from planners.manipulation.reach.hand_reach import Hand, PairReach, PlateQuery
from planners.manipulation.statics.hold_balance import HoldBalance


class RisingReach:
    """What is left of the hands' postures when the plate rises from a goal pose; found out where it is asked."""

    def __init__(
        self, holds: HoldBalance, pair: PairReach, lifted: PlateQuery, heights: Sequence[float], reserved: Balance
    ) -> None:
        """Gather what is asked.

        Args:
            holds: the poses, and all grips and pushes.
            pair: both hands.
            lifted: plate and cup against what stands in the cell.
            heights: (k,) rising, at which postures are looked at [m].
            reserved: program (5) with part of the cup's force kept back for the lifter's jerks.
        """
        self._holds, self._pair, self._lifted, self._reserved = holds, pair, lifted, reserved
        self._up = np.zeros((len(heights), 4, 4))
        self._up[:, 2, 3] = heights
        self._free: dict[int, bool] = {}
        self._postures: dict[tuple[int, Hand, int], int] = {}

    def keeping(self, holds: HoldBalance, reserved: Balance) -> RisingReach:
        """Return what is asked with other programs; where hands go up does not depend on them and stays known."""
        other = copy(self)
        other._holds, other._reserved = holds, reserved
        return other

    def way(self, pose: int) -> Array:
        """Return T_world_plate (k, 4, 4) on the way up from a goal pose."""
        return self._holds.poses.poses[pose].T_world_plate + self._up

    def postures(self, pose: int, hand: Hand, index: int) -> int:
        """Return the postures of a hold that go all the way up from a goal pose: a bit set."""
        key = (pose, hand, index)
        if key not in self._postures:
            reach = self._pair.first if hand == "grip" else self._pair.second
            sets = reach.postures(self.way(pose), slice(index, index + 1)) if self._is_free(pose) else np.zeros(1, int)
            self._postures[key] = int(np.bitwise_and.reduce(sets, axis=None))
        return self._postures[key]

    def bears(self, pose: int, grip: HandHold, push: HandHold) -> bool:
        """Whether two hands bear the plate at a goal pose, the cup's reserve untouched, and both go up from there."""
        if not all(self._allowed(pose, grip, push)):
            return False
        contacts = self._holds.grips[grip.index], self._holds.pushes[push.index]
        rotation = self._holds.poses.poses[pose].T_world_plate[:3, :3]
        answer = self._reserved.solve(rotation, np.empty((0, 3)), *contacts)
        return isinstance(answer, Balanced) and self.together(pose, grip, push)

    def together(self, pose: int, grip: HandHold, push: HandHold) -> bool:
        """Whether any postures of both holds go up from a goal pose with the arms apart."""
        allowed = self._allowed(pose, grip, push)
        return all(allowed) and self._pair.compatible(self.way(pose), (grip.index, push.index), allowed) is not None

    def _allowed(self, pose: int, grip: HandHold, push: HandHold) -> tuple[int, int]:
        return (
            self.postures(pose, "grip", grip.index) & grip.postures,
            self.postures(pose, "push", push.index) & push.postures,
        )

    def _is_free(self, pose: int) -> bool:
        """Whether plate and cup keep clear of what stands in the cell."""
        if pose not in self._free:
            self._free[pose] = bool((self._lifted.first_collisions(self.way(pose)) < 0).all())
        return self._free[pose]
