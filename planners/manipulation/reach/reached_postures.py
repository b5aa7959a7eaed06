"""Which postures of which hold reach which pose of the plate: all of a set are found out where they are wanted."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planners.geometry.pose import Array
from planners.manipulation.reach.hand_reach import Hand, HandReach, PairReach

_Table = NDArray[np.uint64]
"""(poses, holds) sets of postures of one hand."""


class ReachedPostures:
    """The sets of postures of both hands. A graph asks of most only whether they are empty; that is known of all."""

    def __init__(self, pair: PairReach, T_world_plates: Array, some: tuple[_Table, _Table], *, whole: bool) -> None:
        """Take what is known.

        Args:
            pair: both hands.
            T_world_plates: (poses, 4, 4).
            some: (poses, holds) of the gripping hand and of the pushing one: one posture at least of each set that is
                not empty. What is found out is added.
            whole: whether those are all postures.
        """
        self.pair, self.some = pair, some
        self._T_world_plates = T_world_plates
        self._whole = tuple(np.full(table.shape, whole) | (table == 0) for table in some)

    @property
    def sets(self) -> tuple[_Table, _Table]:
        """Both tables (poses, holds) with all postures, the gripping hand's first."""
        return self.grip, self.push

    @property
    def grip(self) -> _Table:
        """(poses, grips) all postures of the gripping hand."""
        return self._completed("grip", np.argwhere(~self._whole[0]))

    @property
    def push(self) -> _Table:
        """(poses, pushes) all postures of the pushing hand."""
        return self._completed("push", np.argwhere(~self._whole[1]))

    def hand(self, hand: Hand) -> HandReach:
        """Return what a hand can be asked."""
        return self.pair.first if hand == "grip" else self.pair.second

    def known(self, hand: Hand, pose: int, hold: int) -> int:
        """Return the postures of a hold that are known to reach a pose: not none, if any does."""
        return int(self.some[_place(hand)][pose, hold])

    def at(self, hand: Hand, pose: int, hold: int) -> int:
        """Return all postures of a hold that reach a pose."""
        if not self._whole[_place(hand)][pose, hold]:
            self._completed(hand, np.array([[pose, hold]]))
        return self.known(hand, pose, hold)

    def of_hold(self, hand: Hand, hold: int) -> NDArray[np.uint64]:
        """Return all postures of a hold that reach each pose (poses,)."""
        poses = np.flatnonzero(~self._whole[_place(hand)][:, hold])
        return self._completed(hand, np.column_stack([poses, np.full(len(poses), hold)]))[:, hold]

    def _completed(self, hand: Hand, entries: NDArray[np.int64]) -> _Table:
        """Find out all postures at entries (n, 2), pose and hold, of a hand's table, and return the table."""
        table, whole = self.some[_place(hand)], self._whole[_place(hand)]
        for hold in np.unique(entries[:, 1]):
            poses = entries[entries[:, 1] == hold, 0]
            found = self.hand(hand).postures(self._T_world_plates[poses], np.array([hold]))
            table[poses, hold], whole[poses, hold] = found[:, 0], True
        return table


def _place(hand: Hand) -> int:
    """Return where a hand's table is among both."""
    return 0 if hand == "grip" else 1
