"""Move one object: choose a suction pose and a regrasp sequence, and turn it into motion (paper A, Fig. 2)."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, fields, replace
from enum import StrEnum
from itertools import islice

import numpy as np

from planners.geometry.pose import Array, inverse
from planners.graph.rejections import Rejection, Rejections
from planners.hands.arm_motion import Stuck
from planners.progress import Progress
from planners.regrasp.graph.cost_to_go import CostToGo
from planners.regrasp.graph.grasp_layer import GraspLayer
from planners.regrasp.graph.object_progress import ObjectProgress, ObjectStage, Tell
from planners.regrasp.graph.regrasp_figures import RegraspFigures
from planners.regrasp.graph.regrasp_graph import Edge, Handover, Pick, Sequence, Transfer
from planners.regrasp.graph.route_figures import route_figures
from planners.regrasp.graph.route_maker import RouteMaker
from planners.regrasp.graph.suction_route import RouteCosts, RouteStart, SuctionRoute
from planners.regrasp.motion.scene_state import SceneState
from planners.regrasp.motion.tool_choreography import ToolChoreographer
from planners.regrasp.motion.tool_room import ToolRoom
from planners.regrasp.suction.suction_poses import SuctionPoses
from planners.regrasp.tool_plan import ConsideredSuction, GraspStep
from planners.regrasp.tool_settings import ToolPlannerSettings
from planners.scene.moved_object import MovedObject


class Stopover(StrEnum):
    """Why an object is put down on its way; the value is what a summary says of it."""

    ASIDE = "put aside first, out of the way of others"
    TAKEN_ANEW = "put down on the way, to be taken at another place"


@dataclass
class SearchCounts:
    """How much was searched for one move, or for several."""

    suction_poses: int = 0
    nodes: int = 0
    """Grasps that were asked for."""
    edges: int = 0
    """Of the regrasp graphs with all grasps."""
    edges_deleted: int = 0
    tries: int = 0
    """Sequences of grasps whose motion was tried."""
    handovers: int = 0

    def include(self, other: SearchCounts) -> None:
        """Add what was counted elsewhere."""
        for each in fields(self):
            setattr(self, each.name, getattr(self, each.name) + getattr(other, each.name))


@dataclass(eq=False)
class ObjectReport:
    """Filled while an object is planned, and read when the plan is told."""

    name: str
    stopover: Stopover | None = None
    """Why the object was only to be put down on its way; None where it was to go to its goal."""
    suctions: list[ConsideredSuction] = field(default_factory=list)
    steps: list[GraspStep] = field(default_factory=list)
    rejections: Rejections = field(default_factory=Rejections)
    counts: SearchCounts = field(default_factory=SearchCounts)
    figures: RegraspFigures | None = None
    """None where no regrasp graph was made."""


_NOT_NEEDED = Rejection("suction", "Another suction pose was found first.")


@dataclass(frozen=True, eq=False)
class Following:
    """The object that is likely moved next."""

    target: MovedObject
    suctions: SuctionPoses


class ObjectPlanner:
    """Plans one object after the other; knows everything that stays the same between them."""

    def __init__(
        self, choreographer: ToolChoreographer, routes: RouteMaker, settings: ToolPlannerSettings, progress: Progress
    ) -> None:
        """Take what all objects share.

        Args:
            choreographer: turns steps into motion.
            routes: grasps and handovers.
            settings: budgets and distances.
            progress: told of what is being done; may raise to stop.
        """
        self.choreographer, self.routes = choreographer, routes
        self.room = ToolRoom(choreographer.queries, settings.carry.descent)
        self.later_room = ToolRoom(choreographer.queries, settings.carry.descent, objects=False)
        self.settings, self.progress = settings, progress
        reach = min(arm.robot.reach for arm in choreographer.workcell.cell.arms.values())
        self._slow = settings.slow_motion * reach / settings.carried.speed
        """What takes longer is slow [s]."""

    def plan(
        self, state: SceneState, target: MovedObject, suctions: SuctionPoses, following: Following | None
    ) -> tuple[SceneState | None, ObjectReport]:
        """Move an object to its goal, or tell why not.

        Args:
            state: where everything is.
            target: the object.
            suctions: in the order in which they are to be tried.
            following: what is likely moved next; without it any grasp is good to end with.
        """
        report = ObjectReport(target.name)
        poses = self.room.poses(state, target, suctions.poses, self.settings.suction_poses, report.rejections)
        if not poses:
            report.rejections.include(suctions.rejections)
            return None, report
        tell = ObjectProgress(self.progress, target.name, len(poses))
        tell(ObjectStage.FIRST_REGRASP)
        start = self.routes.start(state)
        costs = RouteCosts(self._cost_to_go(state, target, following, tell).seconds, self.routes.travel_times)
        possible = self.routes.routes(state, target, poses, start, costs, tell)
        tried: list[SuctionRoute] = []
        while routes := list(islice(possible, self.settings.suction_group)):
            tell.tried = len(tried)
            tell(ObjectStage.FIRST_REGRASP)
            tried += routes
            done = self._try_group(state, target, routes, report)
            if done is not None:
                self._tell(state, tried, done[1], report)
                return done[0], report
            if report.counts.tries >= self.settings.tries:
                break
        self._tell(state, tried, None, report)
        return None, report

    def _cost_to_go(self, state: SceneState, target: MovedObject, following: Following | None, tell: Tell) -> CostToGo:
        """Look at what follows, with the target at its goal."""
        settings, maker = self.settings, self.routes
        if following is None:
            return CostToGo((), 0, maker.travel_times, np.zeros_like(maker.partnerless))
        placed = {**state.T_world_objects, target.name: target.T_world_goal}
        after = replace(state, T_world_objects=placed)
        poses = following.suctions.poses[: settings.suction_group]
        nowhere = RouteStart.nowhere(len(maker.partnerless))
        costs = RouteCosts(lambda positions: np.zeros(len(positions)), maker.travel_times)
        routes = tuple(maker.routes(after, following.target, poses, nowhere, costs, tell))
        otherwise = settings.handover_seconds + settings.partner_weight * maker.partnerless
        return CostToGo(routes, settings.onward_goals, maker.travel_times, otherwise)

    # One group of suction poses.

    def _try_group(
        self, state: SceneState, target: MovedObject, routes: list[SuctionRoute], report: ObjectReport
    ) -> tuple[SceneState, tuple[SuctionRoute, Sequence]] | None:
        """Try the sequences of several suction poses, those with the fewest handovers first; a slow one not alone."""
        realised: dict[tuple[int | Edge, ...], SceneState] = {}
        best: tuple[SceneState, tuple[SuctionRoute, Sequence]] | None = None
        least = math.inf
        second_thoughts = self.settings.second_thoughts
        for number, sequence in islice(self._sequences(routes), self.settings.group_tries):
            route = routes[number]
            route.sequences += 1
            report.counts.tries += 1
            done = self._realise(state, target, route, sequence, realised, (number,), report)
            route.tell(ObjectStage.GRAPH)
            if done is not None:
                q = done.q[self.choreographer.workcell.joints(done.held.arm)]
                total = done.duration + route.cost_to_go(sequence.last, q)
                if total < least:
                    best, least = (done, (route, sequence)), total
                edge, seconds = _slowest(state, realised, number, sequence)
                if seconds <= self._slow or not second_thoughts:
                    break
                second_thoughts -= 1
                route.delete(edge, Rejection("transit", f"A motion of {seconds:.1f} s: a shorter way was looked for"))
                report.counts.edges_deleted += 1
            if report.counts.tries >= self.settings.tries:
                break
        return best

    def _sequences(self, routes: list[SuctionRoute]) -> Iterator[tuple[int, Sequence]]:
        """Yield route numbers and sequences: direct ones of all routes, cheapest first, then route by route."""
        near, everything = self.settings.near_goals, max(len(route.goals) for route in routes)
        for goals in sorted({min(near, everything), everything}):
            while True:
                found = [
                    (sequence.cost, number, sequence)
                    for number, route in enumerate(routes)
                    if route.sequences < self.settings.sequences and (sequence := route.best(0, goals)) is not None
                ]
                if not found:
                    break
                _, number, sequence = min(found, key=lambda entry: entry[:2])
                yield number, sequence
        for handovers in range(1, 2 * self.settings.most_handovers + 1):
            for number, route in enumerate(routes):
                while route.sequences < (1 + handovers) * self.settings.sequences:
                    sequence = route.best(handovers, near)
                    if sequence is None:
                        break
                    yield number, sequence

    def _realise(
        self,
        state: SceneState,
        target: MovedObject,
        route: SuctionRoute,
        sequence: Sequence,
        realised: dict[tuple[int | Edge, ...], SceneState],
        key: tuple[int | Edge, ...],
        report: ObjectReport,
    ) -> SceneState | None:
        """Move along a sequence; where it gets stuck, take out the edge that could not be moved."""
        goal = route.goals[sequence.goal]
        for edge, following in zip(sequence.edges, (*sequence.edges[1:], None), strict=True):
            key = (*key, edge)
            if key not in realised:
                route.tell(ObjectStage.motion(0 if isinstance(edge, Pick) else edge.round))
                try:
                    realised[key] = self._step(state, target, route, goal, edge, following)
                except Stuck as stuck:
                    rejection = replace(stuck.rejection, where=stuck.rejection.where or target.name)
                    report.rejections.add(rejection)
                    report.counts.edges_deleted += 1
                    route.delete(edge, rejection)
                    return None
                route.passed(edge)
            state = realised[key]
        return state

    def _step(
        self,
        state: SceneState,
        target: MovedObject,
        route: SuctionRoute,
        goal: GraspLayer,
        edge: Edge,
        following: Edge | None,
    ) -> SceneState:
        """Move along one edge, on a branch that suits the one that follows if it can be.

        Raises:
            Stuck: it cannot be moved.
        """
        plan, ahead = self.choreographer, _ahead(route, goal, following)
        match edge:
            case Pick(node=node):
                if state.holder is not None:
                    return state
                assert route.start.layer is not None
                held, choices = self.routes.held(node), self.routes.on_the_way(state, node, route.start.layer, ahead)
                return _first_not_stuck(lambda branches: plan.pick_up(state, held, branches, ahead), choices)
            case Handover(receiver=receiver):
                places = self.routes.places(state, receiver, ahead)
                return plan.hand_over(state, self.routes.held(receiver), places, ahead)
            case Transfer(round=0, node=node):
                choices = self.routes.on_the_way(state, node, route.suction, ahead)
                pose = route.pose.T_object_tool
                return _first_not_stuck(lambda branches: plan.suck(state, target.name, pose, branches, ahead), choices)
            case Transfer(node=node):
                T_world_goal = goal.T_world_tool @ inverse(route.pose.T_object_tool)
                return plan.put_down(state, T_world_goal, int(goal.branches[node]))

    # Telling.

    def _tell(
        self,
        state: SceneState,
        routes: list[SuctionRoute],
        done: tuple[SuctionRoute, Sequence] | None,
        report: ObjectReport,
    ) -> None:
        """Write down all that was tried."""
        report.counts.suction_poses += len(routes)
        report.counts.nodes += sum(route.asked for route in routes)
        report.counts.edges += max((route.edge_count for route in routes), default=0)
        chosen, sequence = done or (None, None)
        for route in routes:
            rejection = None if route is chosen else self._given_up(route, done is not None)
            report.suctions.append(ConsideredSuction(report.name, route.pose.T_object_tool, rejection))
            if rejection is not None and not route.sequences and done is None:
                report.rejections.add(rejection)
        drawn = chosen or max(routes, key=lambda route: route.sequences, default=None)
        if drawn is not None:
            report.figures = route_figures(report.name, drawn, state.T_world_tool, sequence)
        if sequence is not None:
            self._tell_steps(state, sequence, report)

    def _given_up(self, route: SuctionRoute, found: bool) -> Rejection:
        """Return why a suction pose is not used."""
        reasons = Counter(rejection for rejection in route.tried.values() if rejection is not None)
        if reasons:
            return max(reasons, key=reasons.__getitem__)
        return _NOT_NEEDED if found else route.emptiness()

    def _tell_steps(self, state: SceneState, sequence: Sequence, report: ObjectReport) -> None:
        """Write down the grasps of the sequence that was moved."""
        by = "picked up" if state.holder is None else "held"
        for edge in sequence.edges:
            if isinstance(edge, Handover):
                held = self.routes.held(edge.receiver)
                report.steps.append(GraspStep(report.name, edge.round, held.arm, held.grasp, "handover"))
            elif isinstance(edge, Pick):
                held = self.routes.held(edge.node)
                report.steps.append(GraspStep(report.name, 0, held.arm, held.grasp, by))
        report.counts.handovers += sequence.handovers


def _slowest(
    state: SceneState, realised: Mapping[tuple[int | Edge, ...], SceneState], number: int, sequence: Sequence
) -> tuple[Edge, float]:
    """Return the edge of a sequence that was moved with the motion that takes longest, and how long that is [s]."""
    slowest, longest = sequence.edges[0], 0.0
    for count, edge in enumerate(sequence.edges, start=1):
        after = realised[number, *sequence.edges[:count]]
        for segment in after.segments[len(state.segments) :]:
            if segment.trajectory.duration > longest:
                slowest, longest = edge, segment.trajectory.duration
        state = after
    return slowest, longest


def _ahead(route: SuctionRoute, goal: GraspLayer, following: Edge | None) -> Array:
    """Return (k, 6) where the arm that has the tool goes along the edge that follows [rad]."""
    match following:
        case Transfer(round=0, node=node):
            positions = route.suction.solutions[node]
        case Transfer(node=node):
            positions = goal.solutions[node]
        case Handover(round=number, giver=giver, receiver=receiver):
            positions = route.handovers.giver_positions(number, giver, receiver)
        case _:
            return np.empty((0, 6))
    return positions[np.isfinite(positions[:, 0])]


def _first_not_stuck(move: Callable[[int], SceneState], choices: tuple[int, ...]) -> SceneState:
    """Move on the first set of branches on which that is possible."""
    *earlier, last = choices
    for branches in earlier:
        with suppress(Stuck):
            return move(branches)
    return move(last)
