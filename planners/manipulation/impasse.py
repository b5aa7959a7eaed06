"""Why a plate lift was not found: at which stage nothing is left, and what would have to be mended there.

Counting all that ever failed would name what fails most often, which is seldom what stands in the way. So the stages
are gone through in the order of a lift (holds at all, the plate at rest, the poses at the goal, and the poses next to
the farthest one that was reached), and at the first that fails each lost pose is asked: would any hold bear the plate
here, wherever the arms reach? If none would, balance is the cause. Otherwise it is what keeps the hand from there; but
where the arms reach holds, and none of those bears the plate, their want of force comes first.
"""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from planners.balance.balanced import Balanced
from planners.balance.relaxed_balance import least_force
from planners.graph.rejections import Rejection, Rejections
from planners.graph.search import DEAD
from planners.manipulation.holds.grips import lack_of_grips
from planners.manipulation.lift_reach import meeting
from planners.manipulation.lift_sampling import cup_footprint, gripping_reach, jaw_of
from planners.manipulation.lift_search import LiftSearch
from planners.manipulation.reach.hand_reach import Closeness, HandReach, Hindrance
from planners.manipulation.statics.hold_balance import HandPair

_POSES = 12
"""Lost poses that are looked at."""
_BALANCES = 60
"""Holds whose balance is asked for at each of them."""
_REACHED = 8
"""Of the holds that the arms reach there, so many are asked how far they are from bearing the plate."""

TOO_WEAK = "no hold that the arms reach bears the plate"
"""What is said where holds that would bear it are out of reach."""

NO_WAY = "No sequence of holds leads from the support into the air."
"""What is said where nobody asks for the causes."""


@dataclass(frozen=True)
class Impasse:
    """Where a lift ends, in one sentence, and why, the weightiest cause first."""

    summary: str
    causes: tuple[Rejection, ...]


def find_impasse(search: LiftSearch) -> Impasse:
    """Say at which stage of a lift nothing is left, and why."""
    return _Stages(search).find()


def _told(summary: str, link: str, causes: tuple[Rejection, ...]) -> Impasse:
    """End a summary with the weightiest cause."""
    if not causes:
        return Impasse(f"{summary}.", causes)
    first, short = causes[0], ""
    if first.reason == TOO_WEAK and first.needed is not None and first.available is not None:
        # What more would do for the step after that, nobody knows yet.
        short = f": the nearest lacks {max(0.1, first.needed - first.available):.1f} N of the cup's pull"
    return Impasse(f"{summary}{link}{first.reason}{short}.", causes)


def _tenths_below(value: float) -> float:
    return math.floor(10.0 * value) / 10.0


class _Stages:
    """Goes through the stages of one lift."""

    def __init__(self, search: LiftSearch) -> None:
        self._search, self._sampling, self._graph = search, search.sampling, search.graph
        self._reach, self._reached = search.reach, search.reach.reached
        self._poses = search.sampling.poses.poses
        self._alive = search.graph.knowledge.status != DEAD

    def find(self) -> Impasse:
        sampling, graph = self._sampling, self._graph
        if not sampling.grips:
            cause = self._lack_of_grips()
            return Impasse(f"The gripper finds no place to hold the plate: {cause.reason}.", (cause,))
        if not sampling.pushes:
            return Impasse("The stick finds no place to push the plate.", ())
        if not any(self._alive[n] and n not in graph.lost_starts for n in graph.starts):
            return self._at_rest()
        if not (graph.goal & self._alive).any():
            return self._at_goal()
        return self._on_the_way()

    def _lack_of_grips(self) -> Rejection:
        sampling, scene = self._sampling, self._sampling.scene
        if scene.given_grips is not None:
            return Rejection("sampling", "the task gives none")
        workcell, cup = sampling.workcell, cup_footprint(scene)
        return lack_of_grips(sampling.prism, jaw_of(workcell), gripping_reach(workcell), cup, sampling.settings.grips)

    def _at_rest(self) -> Impasse:
        """No hand can come to the plate at rest."""
        flat = self._sampling.poses.flat
        if self._graph.starts:
            return Impasse(
                "Hands reach the plate where it rests, but none can come to it.",
                tuple(cause for cause, _ in self._search.record.rejections.most_common(2)),
            )
        causes = self._hindrances([flat], (True, True), "the plate at rest")
        thickness, least = self._sampling.prism.height, self._sampling.least_thickness
        if thickness <= least:
            return self._too_thin(thickness, least, causes)
        gripper, stick = causes[0].reason, causes[1].reason
        return Impasse(
            f"No hand can come to the plate where it rests: for one, {gripper}; for the other, {stick}.", causes
        )

    def _too_thin(self, thickness: float, least: float, causes: tuple[Rejection, ...]) -> Impasse:
        on_table = self._sampling.scene.support_name == "table"
        reason = (
            f"Flat on the {'table' if on_table else 'support'}, a plate that is no thicker than {1e3 * least:.3g} mm "
            "leaves no room for the stick"
        )
        told = f"{reason}; this one is {1e3 * thickness:.3g} mm thick. {self._room_for_the_stick(thickness)}"
        cause = Rejection("reach", reason, "beside the plate at rest", least, thickness, "m")
        return Impasse(told, (cause, *causes))

    def _room_for_the_stick(self, thickness: float) -> str:
        """Say what gives the stick room beside a plate: nothing around it, or else a smaller tip."""
        sampling = self._sampling
        if thickness > sampling.least_thickness_with(0.0):
            if sampling.scene.support_name == "table":
                return "A board under it that is as large as the plate helps, or the edge of the table."
            return "A board that is as large as the plate helps."
        tip, radius = sampling.largest_tip, sampling.workcell.pushing_hand.tip_radius
        if tip <= 0.0:
            return "No stick has room beside so thin a plate."
        room = f"a tip of at most {_tenths_below(1e3 * tip):g} mm radius would have room"
        # A plate of just this thickness still has none.
        enough = _tenths_below(1e3 * sampling.least_thickness_with(0.0)) + 0.1
        return (
            f"With nothing around the plate {room}; that of the cell's stick is {1e3 * radius:.3g} mm, and has room "
            f"beside plates of {enough:g} mm and more on a board that is as large as they are."
        )

    def _at_goal(self) -> Impasse:
        """No two hands can hold the plate at the goal."""
        goals = np.array(self._sampling.poses.goals)
        summary = "No grip and push together can hold the plate off its support"
        grips, pushes = (some[goals].any(axis=1) for some in self._reached.some)
        if (grips & pushes).any():
            causes = self._lost(goals[grips & pushes].tolist(), "off the support")
            return _told(summary, ": ", causes)
        lacking = not grips.any(), not pushes.any()
        causes = self._hindrances(goals.tolist(), lacking if any(lacking) else (True, True), "off the support")
        return _told(summary, ": ", causes)

    def _on_the_way(self) -> Impasse:
        """The plate gets off its rest, perhaps, but not as far as the goal."""
        reached = {int(pose) for pose in self._graph.node_pose[self._graph.reachable()]}
        farthest = max(sorted(reached), key=self._tilt)
        scene = self._sampling.scene
        name = self._poses[farthest].contact.told(scene.plate.outline, scene.T_world_plate)
        degrees = math.degrees(self._tilt(farthest))
        beyond = {int(pose) for known in reached for pose in self._sampling.poses.neighbours[known]} - reached
        causes = self._lost(sorted(beyond, key=lambda pose: (self._distance(farthest, pose), pose)), f"beyond {name}")
        summary = (
            "No sequence of holds leads from the support into the air: "
            f"it gets no farther than a tilt of {degrees:.0f}° ({name})"
        )
        return _told(summary, "; next to that, ", causes)

    def _lost(self, poses: list[int], where: str) -> tuple[Rejection, ...]:
        """Say why poses are lost, the causes of most of them first; the nearest poses come first."""
        found = Rejections()
        for pose in poses[:_POSES]:
            held = self._alive[self._graph.node_pose == pose].any()
            for cause in [self._way_to(pose, where)] if held else self._causes_at(pose, where):
                found.add(cause)
        return tuple(cause for cause, _ in found.most_common(3))

    def _way_to(self, pose: int, where: str) -> Rejection:
        """Say why the plate is not moved to a pose at which it could be held."""
        motions = np.flatnonzero((self._sampling.poses.edges == pose).any(axis=1))
        for number in motions:
            names = self._reach.follower.blocked(int(number))
            if names is not None:
                return Rejection("clearance", f"{meeting(*names).reason} on the way", where)
        return Rejection("transfer", "the plate could be held, but not be brought there", where)

    def _causes_at(self, pose: int, where: str) -> list[Rejection]:
        """Say why no hold that reaches a pose bears the plate there, the weightiest cause first."""
        touch = self._meeting(pose)
        if touch is not None:
            return [Rejection("clearance", touch, where)]
        where_plate = self._poses[pose]
        for hands in itertools.islice(self._unproven(pose), _BALANCES):
            answer = self._search.balance.solve(where_plate.T_world_plate, where_plate.contact_points, hands)
            if isinstance(answer, Balanced):
                return [*self._weakness(pose, where), self._missing(pose, hands, where)]
        return [Rejection("balance", "no hold bears the plate, wherever the arms reach", where)]

    def _weakness(self, pose: int, where: str) -> Iterator[Rejection]:
        """Say that the holds which the arms reach do not bear the plate, if there are any, and what the cup lacks."""
        balance, there = self._search.balance, self._poses[pose]
        reached = ([None, *np.flatnonzero(some[pose]).tolist()] for some in self._reached.some)
        # The last ones have both hands, where both reach.
        holds: list[HandPair] = list(itertools.product(*reached))[:0:-1]
        if not holds:
            return
        least = math.inf
        for hands in holds[:: math.ceil(len(holds) / _REACHED)]:
            if isinstance(balance.solve(there.T_world_plate, there.contact_points, hands), Balanced):
                return
            more = least_force(balance.program(there.T_world_plate, there.contact_points, hands))
            least = least if more is None else min(least, more)
        pull = self._sampling.scene.cup.max_force
        if math.isfinite(least):
            yield Rejection.measured("balance", TOO_WEAK, where, pull + least, pull, "N")
        else:
            yield Rejection("balance", TOO_WEAK, where)

    def _unproven(self, pose: int) -> Iterator[HandPair]:
        """Yield holds that are not yet proven not to bear the plate, reach aside: single hands first."""
        possible = ~self._search.balance.ruled_out[pose]
        order = np.argwhere(possible)
        for row in order[np.argsort((order > 0).sum(axis=1), kind="stable")]:
            grip, push = (None if number == 0 else int(number) - 1 for number in row)
            if (grip, push) != (None, None) and not self._search.balance.ruled_out[pose, row[0], row[1]]:
                yield grip, push

    def _missing(self, pose: int, hands: HandPair, where: str) -> Rejection:
        """Say what keeps the hands of a hold that would bear the plate from being there."""
        for index, hand, postures in (
            (hands[0], self._reach.pair.first, self._reached.some[0]),
            (hands[1], self._reach.pair.second, self._reached.some[1]),
        ):
            if index is not None and not postures[pose, index]:
                hindrance = hand.hindrance(self._poses[pose].T_world_plate, index)
                assert hindrance is not None
                return Rejection("reach", hindrance.reason, where)
        return Rejection("reach", "the two arms would touch", where)

    def _meeting(self, pose: int) -> str | None:
        """Name what the plate or its cup meets at a pose, so that no hold is allowed there."""
        names = next(self._reach.lifted.meetings(self._poses[pose].T_world_plate[None]), None)
        return None if names is None else meeting(*names).reason

    def _hindrances(self, poses: list[int], hands: tuple[bool, bool], where: str) -> tuple[Rejection, ...]:
        """Say what keeps hands (gripper, stick) from poses: for each hand the cause of most of its holds, then more.

        What is in the way of a hold that the arm reaches comes before being out of reach: it is nearer to success.
        """
        lists = [
            self._ranked(hand, poses[:: max(1, len(poses) // 3)][:3])
            for asked, hand in zip(hands, (self._reach.pair.first, self._reach.pair.second), strict=True)
            if asked
        ]
        mixed = [reason for rank in itertools.zip_longest(*lists) for reason in rank if reason is not None]
        return tuple(Rejection("reach", reason, where) for reason in mixed[:4])

    def _ranked(self, hand: HandReach, poses: list[int]) -> list[str]:
        found: Counter[Hindrance] = Counter()
        for pose, hold in itertools.product(poses, range(hand.hold_count)):
            touch = self._meeting(pose)
            hindrance = Hindrance(Closeness.TOUCHING, touch) if touch is not None else self._hindrance(hand, pose, hold)
            if hindrance is not None:
                found[hindrance] += 1
        return [each.reason for each in sorted(found, key=lambda each: (each.closeness, -found[each], each.reason))]

    def _hindrance(self, hand: HandReach, pose: int, hold: int) -> Hindrance | None:
        return hand.hindrance(self._poses[pose].T_world_plate, hold)

    def _tilt(self, pose: int) -> float:
        return float(np.linalg.norm(self._poses[pose].tilt))

    def _distance(self, one: int, other: int) -> float:
        return float(np.linalg.norm(self._poses[one].tilt - self._poses[other].tilt))
