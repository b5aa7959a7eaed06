"""Move one object: choose a suction pose and a regrasp sequence, and turn it into motion (paper A, Fig. 2)."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from planners.collision.placement import Fixed, Placement, Riding
from planners.geometry.pose import Array, Transform, inverse
from planners.graph.rejections import Rejection, Rejections
from planners.progress import Progress
from planners.regrasp.grasp_layer import GraspLayer
from planners.regrasp.grasp_reach import Branches, GraspReach, Surroundings
from planners.regrasp.handovers import HandoverDatabase
from planners.regrasp.object_progress import ObjectProgress, ObjectStage, Tell
from planners.regrasp.regrasp_graph import Edge, Handover, Pick, Sequence, Transfer
from planners.regrasp.suction_poses import SuctionPose, SuctionPoses
from planners.regrasp.suction_route import HandoverMasks, RouteCosts, RouteStart, SuctionRoute
from planners.regrasp.tool_choreography import HandoverPlace, Stuck, ToolChoreographer
from planners.regrasp.tool_plan import ConsideredGrasp, ConsideredSuction, RegraspStep
from planners.regrasp.tool_segment import SuckedObject
from planners.regrasp.tool_settings import ToolPlannerSettings
from planners.regrasp.tool_stage import HeldGrasp, ToolStage
from planners.regrasp.travel import least_travel, solutions
from planners.scene.moved_object import MovedObject

_UP = np.array([0.0, 0.0, 1.0])
_VERTICAL = 1.0 - 1e-6
"""Cosine above which the facet's normal and the vertical are one: then both straight ways of the tool are."""


@dataclass(eq=False)
class ObjectReport:
    """What happened while one object was planned."""

    name: str
    suctions: list[ConsideredSuction] = field(default_factory=list)
    grasps: list[ConsideredGrasp] = field(default_factory=list)
    steps: list[RegraspStep] = field(default_factory=list)
    rejections: Rejections = field(default_factory=Rejections)
    counts: Counter[str] = field(default_factory=Counter)


class ObjectPlanner:
    """Plans one object after the other; knows everything that stays the same between them."""

    def __init__(
        self,
        choreographer: ToolChoreographer,
        handovers: HandoverDatabase,
        park: dict[str, Array],
        settings: ToolPlannerSettings,
        progress: Progress,
    ) -> None:
        """Take what all objects share.

        Args:
            choreographer: turns steps into motion.
            handovers: of the cell and the tool.
            park: (6,) where each arm stands while the other moves [rad].
            settings: budgets and distances.
            progress: told of what is being done; may raise to stop.
        """
        self.choreographer, self.handovers, self.park = choreographer, handovers, park
        self.settings, self.progress = settings, progress
        self.workcell, self.grasps = choreographer.workcell, choreographer.grasps
        self.arms = tuple(self.workcell.cell.arms)
        partners = handovers.partners
        self._masks: dict[bytes, HandoverMasks] = {}
        counts = np.concatenate([partners.sum(axis=1), partners.sum(axis=0)])
        self._partnerless = 1.0 - counts / max(1, counts.max(initial=0))
        self._grasp_settings = settings.handovers.grasps
        self._layer_settings = replace(self._grasp_settings, approach=0.0, step=settings.carry.layer_step)

    def plan(
        self, stage: ToolStage, target: MovedObject, suctions: SuctionPoses, last: bool
    ) -> tuple[ToolStage | None, ObjectReport]:
        """Move an object to its goal, or tell why not.

        Args:
            stage: where everything is.
            target: the object.
            suctions: in the order in which they are to be tried.
            last: whether no object follows: then any grasp is good to end with.
        """
        report = ObjectReport(target.name)
        report.rejections = Rejections()
        poses = suctions.poses[: self.settings.suction_poses]
        tell = ObjectProgress(self.progress, target.name, len(poses))
        tell(ObjectStage.FIRST_REGRASP)
        start = self._start(stage, report)
        if not start.nodes.any():
            return None, report
        weight = 0.0 if last else self.settings.partner_weight
        costs = RouteCosts(weight * self._partnerless)
        for tell.tried in range(0, len(poses), self.settings.suction_group):
            tell(ObjectStage.FIRST_REGRASP)
            group = poses[tell.tried : tell.tried + self.settings.suction_group]
            routes = [self._route(stage, target, pose, start, costs, tell) for pose in group]
            done = self._try_group(stage, target, routes, report)
            self._count(routes, report)
            if done is not None:
                return done, report
            if report.counts["tries"] >= self.settings.tries:
                break
        return None, report

    # One group of suction poses.

    def _try_group(
        self, stage: ToolStage, target: MovedObject, routes: list[SuctionRoute], report: ObjectReport
    ) -> ToolStage | None:
        """Try the sequences of several suction poses, those with the fewest handovers first."""
        tried: Counter[int] = Counter()
        realised: dict[tuple[int, tuple[Edge, ...]], ToolStage] = {}
        for number, sequence in self._sequences(routes, tried):
            route = routes[number]
            tried[number] += 1
            report.counts["tries"] += 1
            done = self._realise(stage, target, route, sequence, realised, (number,), report)
            route.tell(ObjectStage.GRAPH)
            if done is not None:
                self._tell(stage, target, route, sequence, report)
                return done
            if report.counts["tries"] >= self.settings.tries:
                break
        return None

    def _sequences(self, routes: list[SuctionRoute], tried: Counter[int]) -> Iterator[tuple[int, Sequence]]:
        """Yield route numbers and sequences: direct ones of all routes, cheapest first, then route by route."""
        near, everything = self.settings.near_goals, max(len(route.goals) for route in routes)
        for goals in sorted({min(near, everything), everything}):
            while True:
                found = [
                    (sequence.cost, number, sequence)
                    for number, route in enumerate(routes)
                    if tried[number] < self.settings.sequences and (sequence := route.best(0, goals)) is not None
                ]
                if not found:
                    break
                _, number, sequence = min(found, key=lambda entry: entry[:2])
                yield number, sequence
        for handovers in range(1, 2 * self.settings.most_handovers + 1):
            for number, route in enumerate(routes):
                while tried[number] < (1 + handovers) * self.settings.sequences:
                    sequence = route.best(handovers, near)
                    if sequence is None:
                        break
                    yield number, sequence

    def _realise(
        self,
        stage: ToolStage,
        target: MovedObject,
        route: SuctionRoute,
        sequence: Sequence,
        realised: dict,
        key: tuple,
        report: ObjectReport,
    ) -> ToolStage | None:
        """Move along a sequence; where it gets stuck, take out the edge that could not be moved."""
        goal = route.goals[sequence.goal]
        for edge in sequence.edges:
            key = (*key, edge)
            if key not in realised:
                route.tell(ObjectStage.motion(0 if isinstance(edge, Pick) else edge.round))
                try:
                    realised[key] = self._step(stage, target, route, goal, edge)
                except Stuck as stuck:
                    report.rejections.add(stuck.rejection)
                    report.counts["edges deleted"] += 1
                    route.delete(edge)
                    return None
            stage = realised[key]
        return stage

    def _step(
        self, stage: ToolStage, target: MovedObject, route: SuctionRoute, goal: GraspLayer, edge: Edge
    ) -> ToolStage:
        """Move along one edge.

        Raises:
            Stuck: it cannot be moved.
        """
        plan = self.choreographer
        match edge:
            case Pick(node=node):
                if stage.holder is not None:
                    return stage
                return plan.pick_up(stage, self.held(node), int(self._rest.branches[node]))
            case Handover(receiver=receiver):
                return plan.hand_over(stage, self.held(receiver), self._places(stage, self.held(receiver)))
            case Transfer(round=0, node=node):
                branches = int(route.suction.branches[node])
                return plan.suck(stage, target.name, route.pose.T_object_tool, branches)
            case Transfer(node=node):
                T_world_goal = goal.T_world_tool @ inverse(route.pose.T_object_tool)
                return plan.put_down(stage, T_world_goal, int(goal.branches[node]))

    def _places(self, stage: ToolStage, receiver: HeldGrasp) -> list[HandoverPlace]:
        """Return where the holder can hand the tool to a receiver, those with the shortest way for both first."""
        giver = stage.holder
        assert giver is not None
        base = self.handovers
        numbers = base.orientations(giver.arm, giver.grasp, receiver.arm, receiver.grasp)
        if stage.sucked is not None:
            numbers = numbers[self.choreographer.hanging(stage.sucked, base.T_world_tool[numbers])]
        places = [
            (
                self._way(giver, stage.q, T := base.T_world_tool[o], base.reached(giver.arm)[o])
                + self._way(receiver, stage.q, T, base.reached(receiver.arm)[o]),
                int(o),
            )
            for o in numbers
        ]
        return [
            HandoverPlace(
                base.T_world_tool[o],
                int(base.reached(giver.arm)[o, giver.grasp]),
                int(base.reached(receiver.arm)[o, receiver.grasp]),
            )
            for _, o in sorted(places)
        ]

    def _way(self, held: HeldGrasp, q: Array, T_world_tool: Transform, branches: Branches) -> float:
        """Return the least seconds that an arm needs from where it is to a grasp of the tool at a pose."""
        arm = self.workcell.arm(held.arm)
        T_tool_flange = self.choreographer.traffic.T_tool_flange(held)[None]
        there = solutions(arm, T_world_tool, T_tool_flange, branches[held.grasp : held.grasp + 1])
        return float(least_travel(arm, q[self.workcell.joints(held.arm)][None, None], there)[0])

    # Layers.

    def _start(self, stage: ToolStage, report: ObjectReport) -> RouteStart:
        """Return the grasps the tool can be held in: the one it is held in, or all with which it can be picked up."""
        count = len(self.grasps)
        nodes = np.zeros(2 * count, dtype=bool)
        if stage.holder is not None:
            node = self.arms.index(stage.holder.arm) * count + stage.holder.grasp
            nodes[node] = True
            positions = np.full((2 * count, 1, 6), np.nan)
            positions[node, 0] = stage.q[self.workcell.joints(stage.holder.arm)]
            return RouteStart(nodes, positions)
        objects: dict[str, Placement | None] = {name: Fixed(T) for name, T in stage.T_world_objects.items()}
        reaches = {
            arm: GraspReach(self.workcell, arm, self.grasps, self._around(stage, arm, objects), self._grasp_settings)
            for arm in self.arms
        }
        self._rest = GraspLayer(stage.T_world_tool, ((reaches, self.settings.carry.unrest * _UP),))
        nodes = self._rest.ask(np.ones(2 * count, dtype=bool))
        report.counts["grasps at rest"] = int(nodes.sum())
        if not nodes.any():
            report.rejections.add(Rejection("reach", "no grasp of the tool where it rests is in reach of either arm"))
        return RouteStart(nodes, self._rest.solutions)

    def _route(
        self,
        stage: ToolStage,
        target: MovedObject,
        pose: SuctionPose,
        start: RouteStart,
        costs: RouteCosts,
        tell: Tell,
    ) -> SuctionRoute:
        T_tool_object = inverse(pose.T_object_tool)
        objects: dict[str, Placement | None] = {name: Fixed(T) for name, T in stage.T_world_objects.items()}
        objects[target.name] = Riding("tool", T_tool_object)
        laden = {
            arm: GraspReach(self.workcell, arm, self.grasps, self._around(stage, arm, objects), self._layer_settings)
            for arm in self.arms
        }
        lift = self.settings.carry.lift * _UP
        T_world_object = stage.T_world_objects[target.name]
        suction = GraspLayer(T_world_object @ pose.T_object_tool, ((laden, lift),))
        goals = tuple(GraspLayer(T @ pose.T_object_tool, ((laden, lift),)) for T in target.goals)
        base = self.handovers.T_world_tool
        hanging = self.choreographer.hanging(SuckedObject(target.name, T_tool_object), base)
        masks = (self._handover_masks(np.ones(len(base), dtype=bool)), self._handover_masks(hanging))
        return SuctionRoute(pose, start, (suction, goals), masks, costs, self.settings.most_handovers, tell)

    def _handover_masks(self, orientations: NDArray[np.bool_]) -> HandoverMasks:
        """Return which grasps pass the tool on in any of the orientations (o,) that are true."""
        key = orientations.tobytes()
        if key not in self._masks:
            there = np.asarray(self.handovers.compatible[orientations].any(axis=0))
            self._masks[key] = (there, np.ascontiguousarray(there.T))
        return self._masks[key]

    def _around(self, stage: ToolStage, arm: str, objects: dict[str, Placement | None]) -> Surroundings:
        other = self.workcell.other(arm)
        return Surroundings(objects, self.park[other], stage.widths[other])

    def held(self, node: int) -> HeldGrasp:
        """Return the arm and the grasp of a node."""
        arm, grasp = divmod(node, len(self.grasps))
        return HeldGrasp(self.arms[arm], grasp)

    # Telling.

    def _count(self, routes: list[SuctionRoute], report: ObjectReport) -> None:
        report.counts["suction poses"] += len(routes)
        report.counts["nodes"] += sum(route.asked for route in routes)
        report.counts["edges"] = max([report.counts["edges"], *(route.edge_count for route in routes)])

    def _tell(
        self, stage: ToolStage, target: MovedObject, route: SuctionRoute, sequence: Sequence, report: ObjectReport
    ) -> None:
        """Write down the grasps of the sequence that was moved."""
        by = "picked up" if stage.holder is None else "held"
        for edge in sequence.edges:
            if isinstance(edge, Handover):
                held = self.held(edge.receiver)
                report.steps.append(RegraspStep(target.name, edge.round, held.arm, held.grasp, "handover"))
            elif isinstance(edge, Pick):
                held = self.held(edge.node)
                report.steps.append(RegraspStep(target.name, 0, held.arm, held.grasp, by))
        report.counts["handovers"] += sequence.handovers
