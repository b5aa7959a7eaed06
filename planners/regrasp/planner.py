"""Plan a suction-tool task: object after object, in an order that works (paper A, Fig. 2)."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from planners.geometry.pose import Transform, rotation_z, transform
from planners.graph.rejections import Rejection, Rejections
from planners.plan.segment import SegmentKind
from planners.plan.verdicts import PlanningOutcome, shortage_words
from planners.progress import Progress
from planners.regrasp.graph.route_maker import RouteMaker
from planners.regrasp.graph.tool_pickup import not_taken
from planners.regrasp.grasps.handovers import HandoverDatabase, find_handovers
from planners.regrasp.motion.hose import hose_turns
from planners.regrasp.motion.park_pose import park_poses, start_clash
from planners.regrasp.motion.scene_state import SceneState
from planners.regrasp.motion.state_queries import StateQueries
from planners.regrasp.motion.tool_choreography import ToolChoreographer
from planners.regrasp.pile.object_order import ObjectOrder
from planners.regrasp.pile.object_planner import ObjectPlanner, ObjectReport, Stopover
from planners.regrasp.pile.pile_planner import PilePlanner, PileState, SuctionFinder
from planners.regrasp.pile.stopover import Stopovers
from planners.regrasp.statics.hold_statics import HoldStatics
from planners.regrasp.suction.suction_poses import SuctionCandidate, SuctionFault
from planners.regrasp.tool_capacity import impossibilities
from planners.regrasp.tool_plan import ConsideredPlaces, ToolPlan
from planners.regrasp.tool_settings import ToolPlannerSettings
from planners.regrasp.tool_workcell import ToolWorkcell
from planners.scene.moved_object import AXIS_STEP, MovedObject
from planners.scene.standing import Standing
from planners.scene.tool_placements import StillBodies
from planners.scene.tool_scene import SuctionToolScene

_SAME_PLACE = 5e-4
"""An object nearer to its goal than this is there already [m]: half of what the contract allows."""
_SAME_TURN = 4e-3
"""The same for its orientation [rad]."""
_AT_GOAL = 0.999
"""Share of what the contract allows up to which an object that cannot be moved is at its goal [1]: rounding."""
_STILL = 0.2
"""A plan of nothing to do stands still so long: a solved plan has segments [s]."""
_MOST_CAUSES = 5
"""Reasons that are told where there is no plan; all of them are counted."""

_MOST_PLACES = 900
"""Sampled places of the cup that are told for drawing, on all objects together [1]."""


def infeasible_plan(scene: SuctionToolScene) -> ToolPlan | None:
    """Prove that a task has no plan, before anything is made ready to search for one; None: there is no such proof."""
    off_goal = [target for target in scene.objects if _has_to_move(scene, target) and _is_off_goal(target)]
    proofs = tuple(impossibilities(scene, off_goal))
    if not proofs:
        return None
    rejections = Rejections()
    for proof in proofs:
        rejections.add(proof)
    return ToolPlan(PlanningOutcome.INFEASIBLE, f"There is no plan. {_stated(proofs[0])}", proofs, rejections)


def _stated(proof: Rejection) -> str:
    """Return a proof as a sentence that names what it is about, with its figures."""
    figures = ""
    if proof.needed is not None and proof.available is not None:
        figures = f": {shortage_words(proof.needed, proof.available, proof.unit)}"
    return f"{proof.reason.rstrip('.')} ({proof.where}{figures})."


class SuctionToolPlanner:
    """All that is known about one suction-tool task while it is planned."""

    def __init__(
        self,
        scene: SuctionToolScene,
        settings: ToolPlannerSettings,
        handovers: HandoverDatabase | None,
        progress: Progress,
    ) -> None:
        """Prepare; nothing is planned yet.

        Args:
            scene: the task.
            settings: budgets and distances.
            handovers: of the scene's cell and tool; None: it is computed.
            progress: told of what is being done; may raise to stop.
        """
        self.scene, self.settings = scene, settings
        self.rejections = Rejections()
        if handovers is None:
            handovers = find_handovers(scene.cell, scene.tool, settings.handovers, progress)
        self.handovers = handovers
        self.workcell = ToolWorkcell.of(scene, settings.handovers.clearance)
        park = park_poses(scene, self.workcell)
        queries = StateQueries(self.workcell, handovers.grasps)
        rng = np.random.default_rng(scene.seed)
        self.choreographer = ToolChoreographer(queries, HoldStatics(scene), park, settings, rng)
        self._routes = RouteMaker(queries, handovers, self.choreographer.motion.static_hold, park, settings)
        self.suctions = SuctionFinder(scene.tool.cup, scene.cell.gravity, settings.suction, progress)
        still = StillBodies.of(scene.cell, scene.obstacles)
        self.pile = PilePlanner(
            ObjectPlanner(self.choreographer, self._routes, settings, progress),
            self.suctions,
            Stopovers(still, settings.stopover),
            Standing(still.places),
            len(scene.objects) + settings.orders,
            (len(scene.objects) + 1) * settings.tries,
        )
        self._targets = {each.name: each for each in scene.objects}

    def plan(self) -> ToolPlan:
        """Plan a task that `infeasible_plan` proves nothing of; that nothing is found is an answer with its reasons."""
        to_move = [target for target in self.scene.objects if _has_to_move(self.scene, target)]
        start = self._start()
        obstacle = self._obstacle(start, to_move)
        if obstacle is not None:
            return self._unsolved(*obstacle)
        there = frozenset(self._targets) - {target.name for target in to_move}
        pile = self.pile.plan(PileState(start, self._targets, there))
        return self._not_found(there) if pile is None else self._solved(pile)

    def _start(self) -> SceneState:
        scene = self.scene
        return SceneState(
            q=scene.start_positions.copy(),
            widths=dict(scene.start_widths),
            holder=None,
            T_world_tool=scene.tool.T_world_tool,
            T_world_objects={each.name: each.body.T_world_body for each in scene.objects},
            sucked=None,
            segments=(),
        )

    def _obstacle(self, start: SceneState, to_move: list[MovedObject]) -> tuple[str, tuple[Rejection, ...]] | None:
        """Say what stands against any plan before a motion is tried, in a sentence and with its causes."""
        clash = start_clash(self.scene, self.workcell)
        if clash is not None:
            reason = Rejection("start", f"{clash[0]} and {clash[1]} touch at the start")
            return f"The start is not free: {clash[0]} touches {clash[1]}.", (reason,)
        if to_move and not len(self.handovers.grasps):
            opening = max(self.scene.cell.gripper(arm).width_max for arm in self.scene.cell.gripper_arms)
            fingers = f"for fingers that open {1e3 * opening:.0f} mm"
            reason = Rejection("grasp", f"no grasp of the tool was found that is free of collision, {fingers}")
            return f"No grasp of the tool was found {fingers}.", (reason,)
        if to_move:
            margin = self.settings.handovers.clearance.margin
            refused = not_taken(self.scene, self.handovers.grasps, self._routes.start(start), margin)
            if refused is not None:
                return refused
        for target in to_move:
            anywhere = self.suctions.at_start(target)
            if not anywhere.poses:
                return f"No place was found where the cup can sit on {target.name}.", _causes(anywhere.rejections)
        return None

    # What came out.

    def _solved(self, pile: PileState) -> ToolPlan:
        reports = pile.reports
        order = tuple(report.name for report in reports)
        if not order:
            still = self.choreographer.motion.writer.still(pile.state, SegmentKind.TRANSIT, _STILL, {})
            pile = replace(pile, state=still)
            return self._plan(PlanningOutcome.SOLVED, "Every object is at its goal already: nothing moves.", (), pile)
        handovers = sum(report.counts.handovers for report in reports)
        summary = f"{self._order_told(order)}, with {_counted(handovers, 'handover') if handovers else 'no handover'}"
        for why in Stopover:
            names = [report.name for report in reports if report.stopover is why]
            if names:
                summary += f"; {' and '.join(names)} {why.value}"
        return self._plan(PlanningOutcome.SOLVED, f"{summary}.", (), pile)

    def _order_told(self, order: tuple[str, ...]) -> str:
        """Say which objects were moved, and in what order where there is more than one."""
        names = set(order)
        if len(names) == 1:
            return f"{order[0]} moved"
        how = "nearest to its goal first" if order == self._nearest_order() else "in another order than nearest first"
        return f"{_counted(len(names), 'object')} moved, {how} ({', '.join(order)})"

    def _nearest_order(self) -> tuple[str, ...]:
        """Return the objects that have to be moved in the order that is tried first."""
        order = ObjectOrder.of(self.scene.objects)
        moved = {name for name, target in self._targets.items() if not _has_to_move(self.scene, target)}
        following: list[str] = []
        while possible := order.next(moved | set(following)):
            following.append(possible[0])
        return tuple(following)

    def _not_found(self, there: frozenset[str]) -> ToolPlan:
        failed = self.pile.failed
        if not failed:
            causes = ObjectOrder.of(self.scene.objects).deadlock(there)
            return self._unsolved("No object can be moved first.", causes)
        everything, causes = Rejections(), Rejections()
        for report in failed:
            everything.include(report.rejections)
            if report.name == failed[0].name:
                causes.include(report.rejections)
        names, counts = sorted({report.name for report in failed}), self.pile.counts
        tried = (
            f"{_counted(counts.suction_poses, 'suction pose')} and {_counted(counts.tries, 'grasp sequence')} "
            "were tried"
        )
        stages = {rejection.stage for rejection, _ in everything.most_common()}
        if "fall" in stages and stages <= {"fall", "order"}:
            tried, causes = "in no order does everything stand after every step", everything
        elif not counts.suction_poses:
            tried = "the cup has no place that it can hold, with room for the tool, both at the start and at the goal"
        return self._plan(
            PlanningOutcome.NOT_FOUND, f"No way was found to move {' or '.join(names)}: {tried}.", _causes(causes), None
        )

    def _unsolved(self, summary: str, causes: tuple[Rejection, ...]) -> ToolPlan:
        for cause in causes:
            self.rejections.add(cause)
        return self._plan(PlanningOutcome.NOT_FOUND, summary, causes, None)

    def _plan(
        self, outcome: PlanningOutcome, summary: str, causes: tuple[Rejection, ...], pile: PileState | None
    ) -> ToolPlan:
        reports = () if pile is None else pile.reports
        everyone = (*self.pile.failed, *reports)
        for report in everyone:
            self.rejections.include(report.rejections)
        for found in self.suctions.found.values():
            self.rejections.include(found.rejections)
        segments = () if pile is None else pile.state.segments
        turns = hose_turns(segments)
        most_places = max(1, _MOST_PLACES // max(1, len(self.suctions.found)))
        return ToolPlan(
            outcome=outcome,
            segments=segments,
            summary=summary,
            causes=causes,
            rejections=self.rejections,
            graph=self._graph_figures(),
            search=self._search_figures(reports) | {"hose_turns": turns.end, "most_hose_turns": turns.most},
            order=tuple(report.name for report in reports),
            steps=tuple(step for report in reports for step in report.steps),
            considered=ConsideredPlaces(
                places={name: _thinned(found.candidates, most_places) for name, found in self.suctions.found.items()},
                suctions=tuple(each for report in everyone for each in report.suctions),
            ),
            grasps=self.handovers.grasps,
            regrasp=tuple(report.figures for report in everyone if report.figures is not None),
            hose_turns=turns.end,
            most_hose_turns=turns.most,
        )

    def _graph_figures(self) -> dict[str, int]:
        base = self.handovers
        return {
            "grasps": len(base.grasps),
            "handover_pairs": int(base.partners.sum()),
            "handover_orientations": len(base.T_world_tool),
            "nodes": self.pile.counts.nodes,
            "edges": self.pile.counts.edges,
        }

    def _search_figures(self, reports: tuple[ObjectReport, ...]) -> dict[str, int | float | str | None]:
        counts = self.pile.counts
        return {
            "objects_planned": self.pile.planned,
            "put_aside": sum(report.stopover is not None for report in reports),
            "suction_poses": counts.suction_poses,
            "sequences": counts.tries,
            "edges_deleted": counts.edges_deleted,
            "motion_queries": self.choreographer.motion.free.searches,
            "handovers": sum(report.counts.handovers for report in reports),
        }


def _thinned(candidates: tuple[SuctionCandidate, ...], most: int) -> tuple[SuctionCandidate, ...]:
    """Return an even choice of candidates, in order."""
    chosen = np.unique(np.linspace(0, len(candidates) - 1, min(most, len(candidates))).astype(int))
    return tuple(candidates[number] for number in chosen)


def _causes(rejections: Rejections) -> tuple[Rejection, ...]:
    """Return the commonest reasons: of every stage one at least, and last that pads would reach over a border.

    Every flat place has a border, whatever else is wrong with it.
    """
    told = [rejection for rejection, _ in rejections.most_common()]
    told.sort(key=lambda rejection: rejection.reason == SuctionFault.BORDER)
    first = {rejection.stage: rejection for rejection in reversed(told)}
    others = [rejection for rejection in told if rejection not in first.values()]
    kept = [*first.values(), *others][:_MOST_CAUSES]
    return tuple(rejection for rejection in told if rejection in kept)


def _counted(count: int, noun: str) -> str:
    return f"{count} {noun}{'s' if count != 1 else ''}"


def _has_to_move(scene: SuctionToolScene, target: MovedObject) -> bool:
    """Tell whether an object is not at its goal; what nothing can move is there within all the contract allows."""
    if _is_there(target):
        return False
    left = target.off_goal(target.body.T_world_body) <= _AT_GOAL
    return not (left and any(impossibilities(scene, [target])))


def _is_there(target: MovedObject) -> bool:
    """Tell whether an object is at a goal, or turned about its axis from one goal towards the next."""
    T_world_object = target.body.T_world_body
    if any(_same(T_world_object, T) for T in target.goals):
        return True
    return target.turns_freely and sum(_turns_into(T, T_world_object) for T in target.goals) > 1


def _turns_into(T_world_goal: Transform, T_world_object: Transform) -> bool:
    """Tell whether a turn about the axis of a goal, by less than to the next one, leads to a pose."""
    R = T_world_goal[:3, :3].T @ T_world_object[:3, :3]
    angle = math.atan2(R[1, 0] - R[0, 1], R[0, 0] + R[1, 1])
    return abs(angle) < AXIS_STEP and _same(T_world_object, T_world_goal @ transform(rotation_z(angle)))


def _is_off_goal(target: MovedObject) -> bool:
    """Tell whether an object is beyond all doubt not at its goal: neither as it is given, nor as it is settled."""
    return min(target.off_goal(T) for T in (target.T_world_start_given, target.body.T_world_body)) > 1.0


def _same(one: Transform, other: Transform) -> bool:
    return bool(
        np.linalg.norm(one[:3, 3] - other[:3, 3]) < _SAME_PLACE
        and np.linalg.norm(one[:3, :3] - other[:3, :3]) < np.sqrt(2.0) * _SAME_TURN
    )
