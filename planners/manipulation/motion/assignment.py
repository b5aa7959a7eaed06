"""Choose a posture for every hold phase of a path, or say what stands against it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np

from planners.geometry.pose import Array
from planners.graph.rejections import Rejection
from planners.manipulation.graph.failures import GraphFailure, MotionFailure, PairFailure, RiseFailure, TransitFailure
from planners.manipulation.graph.manipulation_graph import HandHold
from planners.manipulation.graph.rising_reach import RisingReach
from planners.manipulation.motion.manipulation_sequence import HoldPhase, ManipulationSequence
from planners.manipulation.motion.phase_track import PhaseTrack
from planners.manipulation.motion.posture_follower import PostureFollower
from planners.manipulation.reach.hand_reach import Hand, bits

Assignment = dict[HoldPhase, int]
"""A posture for each hold phase."""


@dataclass(frozen=True)
class HoldSplit:
    """A hold whose postures must be told apart."""

    hand: Hand
    hold: HandHold
    parts: tuple[int, ...]
    """Disjoint bit sets, together all postures of the hold; at least two."""


@dataclass(frozen=True)
class NoAssignment:
    """Why no postures fit a path: failures found, and holds that must be told apart by posture to apply them."""

    failures: tuple[GraphFailure, ...]
    split: tuple[HoldSplit, ...]
    edge: int | None
    """An edge to give up where neither is to be had."""
    rejection: Rejection


class PostureAssigner:
    """Finds postures for the phases of one sequence."""

    def __init__(
        self,
        follower: PostureFollower,
        sequence: ManipulationSequence,
        start_positions: Array,
        rising: RisingReach | None,
    ) -> None:
        """Gather what is asked.

        Args:
            follower: of postures along the plate's motions.
            sequence: whose hold phases get postures.
            start_positions: (12,) of both arms; postures near them come first [rad].
            rising: what both hands must keep to at the end so that the lift can go on; None: nothing.
        """
        self.follower, self.sequence, self.start_positions = follower, sequence, start_positions
        self._rising = rising

    @cached_property
    def _factors(self) -> dict[HoldPhase, list[tuple[int, GraphFailure]]]:
        """For each phase the sets that its posture must be in, each with the failure it is if it is empty."""
        return {phase: list(self._sets(phase)) for phase in self.sequence.phases}

    def _sets(self, phase: HoldPhase) -> Iterator[tuple[int, GraphFailure]]:
        follower, sequence = self.follower, self.sequence
        hand, index = phase.hand, phase.hold.index
        other: Hand = "push" if hand == "grip" else "grip"
        for place in (phase.first, phase.last):
            ends = (phase.comes, phase.first), (phase.goes, phase.last)
            if any(changes and place == at for changes, at in ends):
                pose = sequence.poses[place]
                survivors = follower.approach(pose, hand, index)
                yield survivors, TransitFailure(pose, hand, index, survivors)
        if self._rising is not None and not phase.goes:
            pose = sequence.poses[phase.last]
            survivors = self._rising.postures(pose, hand, index)
            yield survivors, RiseFailure(pose, hand, index, survivors)
        for place in range(phase.first, phase.last):
            step = sequence.motions[place]
            if step is not None:
                alone = sequence.active(other, place) is None
                survivors = follower.along(step[0], hand, index, alone=alone)
                yield survivors, MotionFailure(step[0], hand, index, survivors, alone)
                if alone:
                    # What fails without the idle arm fails for pairs, too.
                    freely = follower.along(step[0], hand, index, alone=False)
                    yield freely, MotionFailure(step[0], hand, index, freely, False)

    def problem(self) -> NoAssignment | None:
        """Return why postures of single hands cannot fit, or None."""
        failures: list[GraphFailure] = []
        split: dict[HandHold, HoldSplit] = {}
        for phase, factors in self._factors.items():
            hold = phase.hold
            empty = [failure for survivors, failure in factors if not survivors & hold.postures]
            failures += empty
            conflict = [] if empty or self._left(phase) else _conflict(hold.postures, factors)
            if conflict and hold not in split:
                failures += [failure for _, failure in conflict]
                sets = [survivors for survivors, _ in conflict]
                split[hold] = HoldSplit(phase.hand, hold, _parts(hold.postures, sets))
        if failures or split:
            reason = "no posture of a hand follows the plate all the way"
            return NoAssignment(tuple(failures), tuple(split.values()), None, Rejection("transfer", reason))
        for phase, postures in self._preferred.items():
            if not postures:
                reason = "the joints would have to turn beyond their limits while the hand holds the plate"
                place = phase.first - 1 if phase.first > 0 else phase.last - 1
                return NoAssignment((), (), self.sequence.path.edges[place], Rejection("transfer", reason))
        return None

    def assignments(self) -> Iterator[Assignment]:
        """Yield all assignments that keep the arms apart, those near the start positions first."""
        ordered = sorted(self.sequence.phases, key=lambda e: (e.first, e.hand))
        bound = [
            [earlier for earlier in ordered[:depth] if any(_meet(earlier, later) for later in ordered[depth:])]
            for depth in range(len(ordered))
        ]
        yield from self._extend(ordered, bound, {}, set())

    def pair_problem(self) -> NoAssignment:
        """Say why no pair of postures fits: the motions where none does, which holds to split, or where to give up."""
        failures: list[GraphFailure] = []
        rejection = Rejection("transfer", "the two arms would touch on the way in every pair of postures")
        clashing: dict[HoldPhase, None] = {}
        for grip in (e for e in self.sequence.phases if e.hand == "grip"):
            for push in (e for e in self.sequence.phases if e.hand == "push"):
                first, last = max(grip.first, push.first), min(grip.last, push.last)
                if first > last:
                    continue
                for place in range(first, last):
                    step = self.sequence.motions[place]
                    if step is not None and not self._any_together(step[0], grip, push):
                        failures.append(PairFailure(grip.hold, push.hold, motion=step[0]))
                for hand, place in _changes(grip, push):
                    pose = self.sequence.poses[place]
                    names = self._meeting_beside(pose, hand, grip.hold, push.hold)
                    if names is not None:
                        failures.append(PairFailure(grip.hold, push.hold, pose=pose, changing=hand))
                        way = f"{names[0]} and {names[1]} would touch on the straight way to the plate, and off it"
                        rejection = Rejection("transit", way)
                clashing |= {grip: None, push: None}
        splits: dict[HandHold, HoldSplit] = {}
        for phase in clashing:
            hold, left = phase.hold, self._left(phase)
            parts = _parts(hold.postures, [1 << bit for bit in bits(left)])
            if len(parts) > 1:
                splits.setdefault(hold, HoldSplit(phase.hand, hold, parts))
        edge = None if failures or splits else self.sequence.path.edges[-1]
        return NoAssignment(tuple(failures), () if failures else tuple(splits.values()), edge, rejection)

    def _any_together(self, motion: int, grip: HoldPhase, push: HoldPhase) -> bool:
        grips = self.follower.along(motion, "grip", grip.hold.index, alone=False) & grip.hold.postures
        pushes = self.follower.along(motion, "push", push.hold.index, alone=False) & push.hold.postures
        return any(
            self.follower.together(motion, (grip.hold.index, a), (push.hold.index, b))
            for a in bits(grips)
            for b in bits(pushes)
        )

    def _meeting_beside(self, pose: int, coming: Hand, grip: HandHold, push: HandHold) -> tuple[str, str] | None:
        """Name what touches as a hand comes or goes where the other one is on the plate; None where nothing has to."""
        follower, reached = self.follower, self.follower.reached
        if coming == "grip":
            grips, pushes = follower.approach(pose, "grip", grip.index), reached.at("push", pose, push.index)
        else:
            grips, pushes = reached.at("grip", pose, grip.index), follower.approach(pose, "push", push.index)
        names = None
        for a, b in product(bits(grips & grip.postures), bits(pushes & push.postures)):
            names = follower.beside(pose, coming, (grip.index, a), (push.index, b))
            if names is None:
                return None
        return names

    def _extend(
        self,
        ordered: list[HoldPhase],
        bound: list[list[HoldPhase]],
        chosen: Assignment,
        dead: set[tuple[int, ...]],
    ) -> Iterator[Assignment]:
        """Yield what a choice for the first phases can be continued to.

        Later phases ask for nothing but the postures of those that they meet: as these are few, so are the choices that
        have to be told apart, though there are exponentially many.

        Args:
            ordered: all phases, in the order in which they begin.
            bound: for each number of chosen phases those of them that a later one meets.
            chosen: a posture for the first phases.
            dead: depth and postures of the bound phases that are known to lead nowhere; more are added.
        """
        depth = len(chosen)
        if depth == len(ordered):
            yield dict(chosen)
            return
        key = (depth, *(chosen[each] for each in bound[depth]))
        if key in dead:
            return
        phase, leads_on = ordered[depth], False
        met = [each for each in bound[depth] if _meet(each, phase)]
        for posture in self._preferred[phase]:
            if all(self._fits(phase, posture, other, chosen[other]) for other in met):
                for assignment in self._extend(ordered, bound, {**chosen, phase: posture}, dead):
                    leads_on = True
                    yield assignment
        if not leads_on:
            dead.add(key)

    @cached_property
    def _preferred(self) -> dict[HoldPhase, list[int]]:
        """The postures that each phase may take, best first."""
        return {phase: self._ordered(phase) for phase in self.sequence.phases}

    def _ordered(self, phase: HoldPhase) -> list[int]:
        """Postures in the order of their distance from the start position, the farthest joint counting."""
        reach = self.follower.hand(phase.hand)
        T_world_plate = self.follower.poses.poses[self.sequence.poses[phase.first]].T_world_plate[None]
        home = self.start_positions[reach.joints]

        def distance(posture: int) -> float:
            q = reach.follow(T_world_plate, phase.hold.index, posture, home[None])[0]
            return float(np.abs(q - home).max())

        left = bits(self._left(phase))
        return sorted((posture for posture in left if self._within_limits(phase, posture)), key=distance)

    def _left(self, phase: HoldPhase) -> int:
        """The postures of a hand that pass everything on the path, the other hand aside."""
        left = phase.hold.postures
        for survivors, _ in self._factors[phase]:
            left &= survivors
        return left

    def _within_limits(self, phase: HoldPhase, posture: int) -> bool:
        """Whether some whole turns of the joints keep them within limits from approach to retreat."""
        arm = self.follower.hand(phase.hand).arm
        track = PhaseTrack.of(self.follower, self.sequence, phase, posture)
        return len(track.windings(arm.position_min, arm.position_max)) > 0

    def _fits(self, a: HoldPhase, posture_a: int, b: HoldPhase, posture_b: int) -> bool:
        """Whether postures of two phases that meet keep the arms apart wherever both hands are on the plate."""
        grip, push = ((a, posture_a), (b, posture_b)) if a.hand == "grip" else ((b, posture_b), (a, posture_a))
        first, last = max(a.first, b.first), min(a.last, b.last)
        one, two = (grip[0].hold.index, grip[1]), (push[0].hold.index, push[1])
        for place in range(first, last + 1):
            if not self.follower.together_at(self.sequence.poses[place], one, two):
                return False
            step = self.sequence.motions[place] if place < last else None
            if step is not None and not self.follower.together(step[0], one, two):
                return False
        for hand, place in _changes(grip[0], push[0]):
            if self.follower.beside(self.sequence.poses[place], hand, one, two) is not None:
                return False
        if self._rising is None or grip[0].goes or push[0].goes:
            return True
        holds = HandHold(one[0], 1 << one[1]), HandHold(two[0], 1 << two[1])
        return self._rising.together(self.sequence.poses[last], *holds)


def _meet(a: HoldPhase, b: HoldPhase) -> bool:
    """Whether the two hands of two phases are on the plate at the same time."""
    return a.hand != b.hand and max(a.first, b.first) <= min(a.last, b.last)


def _changes(grip: HoldPhase, push: HoldPhase) -> Iterator[tuple[Hand, int]]:
    """Yield which of two hands comes or goes while the other one is on the plate, and the place where both are."""
    for one, other in ((grip, push), (push, grip)):
        if other.first < one.first <= other.last:
            yield one.hand, one.first
        if one.goes and other.first <= one.last < other.last:
            yield one.hand, one.last


def _conflict(postures: int, factors: list[tuple[int, GraphFailure]]) -> list[tuple[int, GraphFailure]]:
    """Choose few of the factors that already leave none of the postures: none of them can be spared."""
    chosen = list(factors)
    for factor in factors:
        others = [other for other in chosen if other is not factor]
        left = postures
        for survivors, _ in others:
            left &= survivors
        if not left:
            chosen = others
    return chosen


def _parts(postures: int, sets: list[int]) -> tuple[int, ...]:
    """Divide postures by which of the sets they are in."""
    parts: dict[tuple[bool, ...], int] = {}
    for bit in bits(postures):
        key = tuple(bool(members >> bit & 1) for members in sets)
        parts[key] = parts.get(key, 0) | 1 << bit
    return tuple(parts.values())
