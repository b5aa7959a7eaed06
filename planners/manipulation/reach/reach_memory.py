"""What is known of the reach of both hands from one lift to the next, where lifts differ in little.

Which postures hold a plate is the costliest thing that lifts have in common: it depends on plate, arms and what stands
in the cell, and not on masses, forces or friction. The lifter's cup and cable only take postures away, so that their
place may change, too: what is left then is asked of the postures that were found without a lifter.
"""

from __future__ import annotations

import hashlib
from collections import OrderedDict
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from planners.geometry.pose import Array
from planners.manipulation.reach.hand_reach import HandReach, PairReach
from planners.manipulation.reach.lift_workcell import LiftWorkcell

_MOST_SURROUNDINGS = 256
"""So many are remembered, the last ones that were asked for: some hundred kilobytes each."""

_Columns = dict[bytes, NDArray[np.uint64]]
"""Of one hold each, by its poses of the hand: the sets of postures (poses,)."""


class ReachMemory:
    """Postures by all that they depend on, to the last bit: what is remembered is what would be found anew."""

    def __init__(self) -> None:
        self._known: OrderedDict[bytes, _Columns] = OrderedDict()
        """By what surrounds the hand, and where the plate is."""

    def postures(
        self, workcell: LiftWorkcell, pair: PairReach, T_world_plates: Array
    ) -> tuple[NDArray[np.uint64], NDArray[np.uint64]]:
        """Return what `HandReach.postures` does of both hands, and remember it.

        Args:
            workcell: of the lift.
            pair: its gripper, and its pusher.
            T_world_plates: (poses, 4, 4).
        """
        hands = ((workcell.gripper, pair.first), (workcell.pusher, pair.second))
        with ThreadPoolExecutor(2) as threads:
            found = [threads.submit(self._of_hand, workcell, arm, hand, T_world_plates) for arm, hand in hands]
            first, second = (future.result() for future in found)
        return first, second

    def _of_hand(self, workcell: LiftWorkcell, arm: str, hand: HandReach, T_world_plates: Array) -> NDArray[np.uint64]:
        """Return the (poses, holds) sets of postures of a hand at plate poses (poses, 4, 4), as the pair has them."""
        alone, hand_only = workcell.without_other(arm), workcell.hand_without_other(arm)
        without = replace(
            hand,
            alone=workcell.plate_query(workcell.unlifted, alone, hands=[arm]),
            hand_only=workcell.plate_query(workcell.unlifted, hand_only, hands=[arm]),
        )
        lifter = replace(
            hand,
            alone=workcell.plate_query(workcell.holding, workcell.with_lifter(alone), hands=[arm]),
            hand_only=workcell.plate_query(workcell.holding, workcell.with_lifter(hand_only), hands=[arm]),
        )
        key = _key(without, b"", T_world_plates)
        among = self._columns(key, without, T_world_plates, None)
        return self._columns(_key(lifter, key, T_world_plates), lifter, T_world_plates, among)

    def _columns(
        self, key: bytes, hand: HandReach, T_world_plates: Array, among: NDArray[np.uint64] | None
    ) -> NDArray[np.uint64]:
        """Return what `HandReach.postures` does, of which each hold's column is looked for once under a key."""
        known = self._known.setdefault(key, {})
        self._known.move_to_end(key)
        while len(self._known) > _MOST_SURROUNDINGS:
            self._known.popitem(last=False)
        names = [poses.tobytes() for poses in hand.T_plate_flange]
        unknown = np.array([number for number, name in enumerate(names) if name not in known], np.intp)
        if len(unknown):
            # Which columns are asked among is known by the key.
            asked = None if among is None else among[:, unknown]
            found = hand.postures(T_world_plates, unknown, asked)
            known |= {names[number]: found[:, column] for column, number in enumerate(unknown)}
        columns = [known[name] for name in names]
        return np.column_stack(columns) if columns else np.zeros((len(T_world_plates), 0), np.uint64)


def _key(hand: HandReach, asked: bytes, T_world_plates: Array) -> bytes:
    """Return a hash of all that the postures of a hold depend on but the hold; `asked` is that of those asked for."""
    digest = hashlib.sha256(asked)
    queries = (hand.alone.kernel(), hand.hand_only.kernel())
    _add(digest, (hand.kernel, queries, T_world_plates, hand.start_positions))
    return digest.digest()


def _add(digest: hashlib._Hash, value: object) -> None:
    """Add numbers, arrays of them and what is made of these, each with its shape, so that none runs into the next."""
    if isinstance(value, tuple):
        digest.update(f"({len(value)}".encode())
        for each in value:
            _add(digest, each)
    else:
        array = np.asarray(value)
        digest.update(f"{array.dtype}{array.shape}".encode())
        digest.update(np.ascontiguousarray(array).tobytes())
