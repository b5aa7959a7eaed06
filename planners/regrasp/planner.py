"""Plan a suction-tool task: object after object, in an order that works (paper A, Fig. 2)."""

from __future__ import annotations

from collections import Counter

import numpy as np

from planners.geometry.pose import Transform
from planners.graph.rejections import Rejection, Rejections
from planners.progress import Progress
from planners.regrasp.grasps import tool_grasps
from planners.regrasp.handovers import HandoverDatabase, build_handovers
from planners.regrasp.hold_statics import HoldStatics
from planners.regrasp.hose import hose_turns
from planners.regrasp.object_order import ObjectOrder
from planners.regrasp.object_planner import ObjectPlanner, ObjectReport
from planners.regrasp.park_pose import park_poses, start_clash
from planners.regrasp.suction_poses import SuctionLoad, SuctionPoses, suction_poses
from planners.regrasp.tool_choreography import ToolChoreographer
from planners.regrasp.tool_plan import Considered, ToolOutcome, ToolPlan
from planners.regrasp.tool_settings import ToolPlannerSettings
from planners.regrasp.tool_stage import ToolStage
from planners.regrasp.tool_traffic import ToolTraffic
from planners.regrasp.tool_workcell import ToolWorkcell
from planners.scene.hand import Gripper
from planners.scene.moved_object import MovedObject
from planners.scene.tool_scene import SuctionToolScene

_SAME_PLACE = 5e-4
"""An object nearer to its goal than this is there already [m]: half of what the contract allows."""
_SAME_TURN = 4e-3
"""The same for its orientation [rad]."""


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
        self.scene, self.settings, self.progress = scene, settings, progress
        self.rejections, self.counts = Rejections(), Counter[str]()
        self.handovers = self._built_handovers() if handovers is None else handovers
        self.workcell = ToolWorkcell.of(scene, settings.handovers.clearance)
        self.order = ObjectOrder.of(scene.objects)
        self.park = park_poses(scene, self.workcell)
        self.choreographer = ToolChoreographer(
            ToolTraffic(self.workcell, self.handovers.grasps),
            HoldStatics(scene),
            self.park,
            settings,
            np.random.default_rng(scene.seed),
        )
        self.objects = ObjectPlanner(self.choreographer, self.handovers, self.park, settings, progress)
        self._targets = {each.name: each for each in scene.objects}
        self._suctions: dict[str, SuctionPoses] = {}
        self._failed: list[ObjectReport] = []
        self._planned = 0

    def plan(self) -> ToolPlan:
        """Plan the task; that there is no plan is an answer, with its reasons."""
        clash = start_clash(self.scene, self.workcell)
        if clash is not None:
            reason = Rejection("start", f"{clash[0]} and {clash[1]} touch at the start")
            return self._unsolved(
                ToolOutcome.INFEASIBLE, f"The start is not free: {clash[0]} touches {clash[1]}.", reason
            )
        if not len(self.handovers.grasps):
            reason = Rejection("grasp", "the gripper cannot take the tool anywhere")
            return self._unsolved(ToolOutcome.INFEASIBLE, "The gripper cannot take the tool anywhere.", reason)
        for target in self.scene.objects:
            suctions = self._suctions_of(target)
            if not suctions.poses:
                return self._no_suction(target, suctions)
        there = frozenset(name for name, target in self._targets.items() if self._is_there(target))
        found = self._next(self._start(), there, ())
        if found is None:
            return self._not_found()
        stage, reports = found
        return self._solved(stage, reports)

    # Object after object.

    def _start(self) -> ToolStage:
        scene = self.scene
        return ToolStage(
            q=scene.start_positions.copy(),
            widths=dict(scene.start_widths),
            holder=None,
            T_world_tool=scene.tool.T_world_tool,
            T_world_objects={each.name: each.body.T_world_body for each in scene.objects},
            sucked=None,
            segments=(),
        )

    def _next(
        self, stage: ToolStage, moved: frozenset[str], reports: tuple[ObjectReport, ...]
    ) -> tuple[ToolStage, tuple[ObjectReport, ...]] | None:
        """Plan the objects that are left, the one nearest to its goal first; if that fails, another one first."""
        if len(moved) == len(self._targets):
            return stage, reports
        for name in self.order.next(moved):
            if self._planned >= len(self._targets) + self.settings.orders:
                return None
            self._planned += 1
            last = len(moved) + 1 == len(self._targets)
            after, report = self.objects.plan(stage, self._targets[name], self._suctions[name], last)
            self.counts.update(report.counts)
            if after is None:
                self._failed.append(report)
                continue
            found = self._next(after, moved | {name}, (*reports, report))
            if found is not None:
                return found
        return None

    def _suctions_of(self, target: MovedObject) -> SuctionPoses:
        body = target.body
        assert body.mass is not None
        self.progress(f"suction {target.name}", 0, 1)
        load = SuctionLoad(body.mass, body.com, body.T_world_body, target.goals)
        self._suctions[target.name] = suction_poses(
            body.solid.surface(), load, self.scene.tool.cup, self.settings.suction
        )
        return self._suctions[target.name]

    def _is_there(self, target: MovedObject) -> bool:
        return any(_same(target.body.T_world_body, T) for T in target.goals)

    def _built_handovers(self) -> HandoverDatabase:
        settings, arms = self.settings.handovers, self.scene.cell.arms
        gripper = next(iter(arms.values())).hand
        assert isinstance(gripper, Gripper)
        grasps = tool_grasps(self.scene.tool, gripper, settings.grasps)
        return build_handovers(self.scene.cell, self.scene.tool, grasps, settings, self.progress)

    # What came out.

    def _solved(self, stage: ToolStage, reports: tuple[ObjectReport, ...]) -> ToolPlan:
        order = tuple(report.name for report in reports)
        handovers = sum(report.counts["handovers"] for report in reports)
        nearest = self._nearest_order()
        how = "nearest to its goal first" if order == nearest else "in another order than nearest first"
        what = f"{len(order)} object{'s' if len(order) != 1 else ''}"
        changes = "no handover" if not handovers else f"{handovers} handover{'s' if handovers > 1 else ''}"
        summary = f"{what} moved, {how} ({', '.join(order)}), with {changes}."
        if not order:
            summary = "Every object is at its goal already."
        return self._plan(ToolOutcome.SOLVED, stage, summary, (), reports)

    def _nearest_order(self) -> tuple[str, ...]:
        """Return the objects that have to be moved in the order that is tried first."""
        moved = frozenset(name for name, target in self._targets.items() if self._is_there(target))
        order: list[str] = []
        while following := self.order.next(moved | set(order)):
            order.append(following[0])
        return tuple(order)

    def _not_found(self) -> ToolPlan:
        for report in self._failed:
            for rejection, count in report.rejections.most_common(1000):
                self.rejections.add(rejection, count)
        if not self._failed:
            waiting = [name for name in self._targets if not self.order.next(frozenset()) or name]
            reason = Rejection("order", f"each of {', '.join(waiting)} would have to be moved before another of them")
            return self._unsolved(ToolOutcome.NOT_FOUND, "No object can be moved first.", reason)
        worst = self._failed[0]
        causes = [rejection for rejection, _ in worst.rejections.most_common(5)]
        names = sorted({report.name for report in self._failed})
        summary = (
            f"No way was found to move {' or '.join(names)}: {self.counts['suction poses']} suction poses and "
            f"{self.counts['tries']} grasp sequences were tried."
        )
        return self._plan(ToolOutcome.NOT_FOUND, None, summary, tuple(causes), ())

    def _no_suction(self, target: MovedObject, suctions: SuctionPoses) -> ToolPlan:
        causes = [rejection for rejection, _ in suctions.rejections.most_common(5)]
        for rejection, count in suctions.rejections.most_common(1000):
            self.rejections.add(rejection, count)
        summary = f"The cup cannot sit anywhere on {target.name}."
        return self._plan(ToolOutcome.INFEASIBLE, None, summary, tuple(causes), ())

    def _unsolved(self, outcome: ToolOutcome, summary: str, reason: Rejection) -> ToolPlan:
        self.rejections.add(reason)
        return self._plan(outcome, None, summary, (reason,), ())

    def _plan(
        self,
        outcome: ToolOutcome,
        stage: ToolStage | None,
        summary: str,
        causes: tuple[Rejection, ...],
        reports: tuple[ObjectReport, ...],
    ) -> ToolPlan:
        for report in reports:
            for rejection, count in report.rejections.most_common(1000):
                self.rejections.add(rejection, count)
        segments = () if stage is None else stage.segments
        turns = hose_turns(segments)
        everyone = (*reports, *self._failed)
        base = self.handovers
        return ToolPlan(
            outcome=outcome,
            segments=segments,
            summary=summary,
            causes=causes,
            rejections=self.rejections,
            graph={
                "grasps": len(base.grasps),
                "handover_pairs": int(base.partners.sum()),
                "handover_orientations": len(base.T_world_tool),
                "nodes": self.counts["nodes"],
                "edges": self.counts["edges"],
            },
            search={
                "objects_planned": self._planned,
                "suction_poses": self.counts["suction poses"],
                "sequences": self.counts["tries"],
                "edges_deleted": self.counts["edges deleted"],
                "motion_queries": self.choreographer.motion_queries,
                "handovers": sum(report.counts["handovers"] for report in reports),
                "hose_turns": turns.end,
                "most_hose_turns": turns.most,
            },
            order=tuple(report.name for report in reports),
            steps=tuple(step for report in reports for step in report.steps),
            considered=Considered(
                places={name: suctions.candidates for name, suctions in self._suctions.items()},
                suctions=tuple(each for report in everyone for each in report.suctions),
                grasps=tuple(each for report in everyone for each in report.grasps),
            ),
            hose_turns=turns.end,
            most_hose_turns=turns.most,
        )


def _same(one: Transform, other: Transform) -> bool:
    return bool(
        np.linalg.norm(one[:3, 3] - other[:3, 3]) < _SAME_PLACE
        and np.linalg.norm(one[:3, :3] - other[:3, :3]) < np.sqrt(2.0) * _SAME_TURN
    )
