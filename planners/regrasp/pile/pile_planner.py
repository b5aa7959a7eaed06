"""Move objects one after the other, in an order that works, some of them by way of a stopover."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

from planners.geometry.pose import Array, Transform
from planners.graph.rejections import Rejection, Rejections
from planners.progress import Progress, Report
from planners.regrasp.motion.scene_state import SceneState
from planners.regrasp.pile.object_order import ObjectOrder
from planners.regrasp.pile.object_planner import Following, ObjectPlanner, ObjectReport, SearchCounts, Stopover
from planners.regrasp.pile.stopover import Stopovers
from planners.regrasp.suction.suction_poses import SuctionLoad, SuctionPoses, SuctionSettings, suction_poses
from planners.scene.body import Body
from planners.scene.moved_object import MovedObject
from planners.scene.standing import Standing
from planners.scene.suction_tool import CupData

_HOPELESS = 3
"""Moves of an object without any sequence of grasps, after which no stopover is tried any more [1]."""


@dataclass(frozen=True, eq=False)
class PileState:
    """How far a plan has come."""

    state: SceneState
    objects: Mapping[str, MovedObject]
    """All of them, those that wait where they stand now."""
    moved: frozenset[str]
    """Those that are at their goals."""
    on_the_way: frozenset[str] = frozenset()
    """Those that made a stopover; none makes two."""
    reports: tuple[ObjectReport, ...] = ()
    """Of what was moved, in order."""

    def after(self, state: SceneState, report: ObjectReport) -> PileState:
        """Return the state with one more move."""
        name, reports = report.name, (*self.reports, report)
        if report.stopover is None:
            return replace(self, state=state, moved=self.moved | {name}, reports=reports)
        target = self.objects[name]
        body = replace(target.body, T_world_body=state.T_world_objects[name])
        objects = {**self.objects, name: replace(target, body=body)}
        return replace(self, state=state, objects=objects, on_the_way=self.on_the_way | {name}, reports=reports)


class SuctionFinder:
    """Suction poses of objects, each found once."""

    def __init__(self, cup: CupData, gravity: Array, settings: SuctionSettings, progress: Progress) -> None:
        """Take the tool's cup and the cell's gravity (3,) [m/s^2]."""
        self.found: dict[str, SuctionPoses] = {}
        """By object, the last that were found from where it stood to its goal."""
        self._known: dict[tuple[str, bytes, bytes], SuctionPoses] = {}
        self._cup, self._gravity, self._settings, self._progress = cup, gravity, settings, progress

    def to_goal(self, target: MovedObject) -> SuctionPoses:
        """Return the poses of an object on its way to its goal."""
        self.found[target.name] = self.between(target)
        return self.found[target.name]

    def between(self, target: MovedObject) -> SuctionPoses:
        """Return the poses with which an object can be taken where it stands and put down at its goals."""
        key = (target.name, target.body.T_world_body.tobytes(), target.goals.tobytes())
        if key not in self._known:
            self._known[key] = self._find(target)
        return self._known[key]

    def at_start(self, target: MovedObject) -> SuctionPoses:
        """Return the poses with which an object can be lifted where it stands, or to its goal where there are some."""
        found = self.to_goal(target)
        return found if found.poses else self._find(target, to_goals=False)

    def _find(self, target: MovedObject, *, to_goals: bool = True) -> SuctionPoses:
        body = target.body
        assert body.mass is not None
        self._progress(Report("suction", 0, 1, target.name))
        load = SuctionLoad(body.mass, body.com, body.T_world_body, self._gravity, target.goals if to_goals else None)
        return suction_poses(body.solid.surface(), load, self._cup, self._settings)


class PilePlanner:
    """Searches the order of the objects, depth first: the one nearest to its goal first."""

    def __init__(
        self,
        objects: ObjectPlanner,
        suctions: SuctionFinder,
        stopovers: Stopovers,
        standing: Standing,
        most_plans: int,
        most_tries: int,
    ) -> None:
        """Take what all orders share.

        Args:
            objects: plans one move.
            suctions: suction poses.
            stopovers: free places.
            standing: tells what falls.
            most_plans: moves that are planned at all, whatever becomes of them.
            most_tries: sequences of all moves whose motion is tried, after which no further move is planned.
        """
        self.objects, self.suctions, self.stopovers, self.standing = objects, suctions, stopovers, standing
        self.most_plans, self.most_tries = most_plans, most_tries
        self.failed: list[ObjectReport] = []
        """Of moves that were not found, and of those that led nowhere."""
        self.counts = SearchCounts()
        self.planned = 0

    def plan(self, pile: PileState) -> PileState | None:
        """Plan the moves that are left; None if none of the orders tried leads to the end."""
        if len(pile.moved) == len(pile.objects):
            return pile
        order = ObjectOrder.of(tuple(pile.objects.values()))
        for target, stopover in self._moves(pile, order):
            if self.planned >= self.most_plans or self.counts.tries >= self.most_tries:
                return None
            after = self._moved(pile, target, stopover)
            found = None if after is None else self.plan(after)
            if found is not None:
                return found
        return None

    def _moved(self, pile: PileState, target: MovedObject, stopover: Stopover | None) -> PileState | None:
        self.planned += 1
        suctions = self.suctions.between(target)
        state, report = self.objects.plan(pile.state, target, suctions, self._following(pile, target, stopover))
        report.stopover = stopover
        self.counts.include(report.counts)
        if state is None:
            self.failed.append(report)
            return None
        return pile.after(state, report)

    def _following(self, pile: PileState, target: MovedObject, stopover: Stopover | None) -> Following | None:
        """Return what is likely moved after a target, if anything is."""
        moved = pile.moved | {target.name} if stopover is None else pile.moved
        order = ObjectOrder.of(tuple(pile.objects.values()))
        name = next((name for name in order.next(moved) if name != target.name), None)
        return None if name is None else Following(pile.objects[name], self.suctions.to_goal(pile.objects[name]))

    def _moves(self, pile: PileState, order: ObjectOrder) -> Iterator[tuple[MovedObject, Stopover | None]]:
        """Yield what can be moved next: to its goal, then to a stopover, those first that the cup cannot take there."""
        possible = order.next(pile.moved)
        for name in possible:
            target = self._standing_at_goals(pile, name) if self._can_be_taken(pile, name, None) else None
            if target is None:
                continue
            suctions = self.suctions.to_goal(target)
            if suctions.poses:
                yield target, None
            else:
                self._fail(name, None, suctions.rejections)
        waiting = [name for name in order.next_aside(pile.moved) if name not in pile.on_the_way]
        for name in sorted(waiting, key=lambda name: bool(self.suctions.to_goal(pile.objects[name]).poses)):
            why = Stopover.TAKEN_ANEW if name in possible else Stopover.ASIDE
            if self._can_be_taken(pile, name, why):
                for target in self._stopovers(pile, name, why):
                    yield target, why

    def _can_be_taken(self, pile: PileState, name: str, stopover: Stopover | None) -> bool:
        """Tell whether all other objects stand while one is carried."""
        rest = {other: (each.body, pile.state.T_world_objects[other]) for other, each in pile.objects.items()}
        del rest[name]
        fall = self.standing.fall(rest)
        if fall is not None:
            self._fail(name, stopover, _refusal("fall", f"once {name} is taken away, {fall}", name))
        return fall is None

    def _standing_at_goals(self, pile: PileState, name: str) -> MovedObject | None:
        """Return an object with those of its goals at which all objects stand, now and in the end; None without any.

        Those that are at their goals stay as they stand there, turned as they may be; the others are to come to theirs
        as they are given.
        """
        target, T_now = pile.objects[name], pile.state.T_world_objects
        now = {other: (each.body, T_now[other]) for other, each in pile.objects.items()}
        end = {
            other: (each.body, T_now[other] if other in pile.moved else each.T_world_goal)
            for other, each in pile.objects.items()
        }
        goals, refusals = [], Rejections()
        for T in target.goals:
            there = {name: (target.body, T)}
            fall = self.standing.fall(now | there) or self.standing.fall(end | there)
            if fall is None:
                goals.append(T)
            else:
                refusals.include(_refusal("fall", f"with {name} at its goal, {fall}", name))
        if not goals:
            self._fail(name, None, refusals)
            return None
        return target if len(goals) == len(target.goals) else target.to(goals)

    def _stopovers(self, pile: PileState, name: str, why: Stopover) -> Iterator[MovedObject]:
        """Yield free places for an object, in poses from which the cup can take it to its goal."""
        target, others = pile.objects[name], _others(pile, name)
        reason = f"{name} cannot be put down on the way to its goal: it rests on no other face, or nowhere is room"
        for stopover in self.stopovers.targets(target, others):
            if self._is_hopeless(name):
                return
            leading_on = self._leading_on(pile, target, stopover)
            if leading_on:
                reason = ""
                yield stopover.to(leading_on)
            elif reason:
                reason = f"{name} cannot be put down on the way to its goal: the cup would not have it there and back"
        if reason:
            self._fail(name, why, _refusal("order", reason, name))

    def _is_hopeless(self, name: str) -> bool:
        """Tell whether an object was asked for often enough where no sequence of grasps leads anywhere."""
        counts = [report.counts for report in self.failed if report.name == name]
        return sum(bool(each.suction_poses and not each.tries) for each in counts) >= _HOPELESS

    def _leading_on(self, pile: PileState, target: MovedObject, stopover: MovedObject) -> list[Transform]:
        """Return the poses at a stopover from which the cup can take an object to its goal.

        Hands are left out, and for the way on the other objects too: they may have been moved by then.
        """
        room = self.objects.room
        if not room.poses(pile.state, stopover, self.suctions.between(stopover).poses, 1, Rejections()):
            return []
        leading_on = []
        for T in stopover.goals:
            there = replace(target, body=replace(target.body, T_world_body=stopover.T_world_goal))
            state = replace(pile.state, T_world_objects={**pile.state.T_world_objects, target.name: T})
            if self.objects.later_room.poses(state, there, self.suctions.between(there).poses, 1, Rejections()):
                leading_on.append(T)
        return leading_on

    def _fail(self, name: str, stopover: Stopover | None, rejections: Rejections) -> None:
        self.failed.append(ObjectReport(name, stopover))
        self.failed[-1].rejections.include(rejections)


def _refusal(state: str, reason: str, name: str) -> Rejections:
    return Rejections.of(Rejection(state, reason, name))


def _others(pile: PileState, name: str) -> list[tuple[Body, Transform]]:
    """Return all other objects where they are, and those that wait also where they are to go."""
    others = [each for each in pile.objects.values() if each.name != name]
    here = [(each.body, pile.state.T_world_objects[each.name]) for each in others]
    return here + [(each.body, each.T_world_goal) for each in others if each.name not in pile.moved]
