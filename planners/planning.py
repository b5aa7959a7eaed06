"""From a scene to a plan. Certifying it is `planners.certify`, apart on purpose."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any, Protocol

from planners.cell.cell import Cell
from planners.contract.task_spec import PlateLiftOptions, PlateLiftTask, SuctionToolTask, read_task, write_task
from planners.errors import SceneError
from planners.geometry.pose import pose_row
from planners.manipulation import plan_segments as lift_segments
from planners.manipulation.contacts.dense_contact_states import ContactSampling
from planners.manipulation.lift_attempts import plan_lift
from planners.manipulation.lift_plan import LiftPlan
from planners.manipulation.lift_settings import LiftSettings
from planners.plan.plan import SCHEMA_VERSION, Plan
from planners.plan.scenery import JOINT_NAMES, BodyDocument
from planners.plan.segment import Segment
from planners.plan.verdicts import Cause, Explanation, Software, StageTime, Statistics
from planners.progress import Progress
from planners.regrasp import plan_segments as tool_segments
from planners.regrasp.considered import considered_by
from planners.regrasp.grasps.handovers import HandoverDatabase, HandoverSettings, find_handovers
from planners.regrasp.planner import infeasible_plan
from planners.regrasp.reserve_search import plan_with_reserve
from planners.regrasp.tool_plan import ToolPlan
from planners.regrasp.tool_settings import ToolPlannerSettings
from planners.scene.lift_scene import PlateLiftScene
from planners.scene.scene import with_centres
from planners.scene.suction_tool import SuctionTool
from planners.scene.tool_scene import SuctionToolScene


class HandoverSource(Protocol):
    """Where the handovers of a cell and a tool come from: computed, or kept from earlier."""

    def __call__(
        self, cell: Cell, tool: SuctionTool, settings: HandoverSettings, progress: Progress
    ) -> HandoverDatabase:
        """Return what `find_handovers` returns for the same arguments."""
        ...


def plan(
    task: PlateLiftTask | SuctionToolTask,
    scene: PlateLiftScene | SuctionToolScene,
    progress: Progress,
    clock: Callable[[], float],
    handovers: HandoverSource = find_handovers,
) -> Plan:
    """Plan a task; that there is no plan is an answer, with its reasons.

    Args:
        task: as accepted.
        scene: built from it.
        progress: told what is being done; may raise `PlanningCancelled`.
        clock: seconds, for the statistics only; no decision depends on it.
        handovers: asked once by a suction-tool task that may have a plan; computing them takes some seconds.

    Returns:
        The plan, without certificate; its id and what software made it are for the caller to fill in.

    Raises:
        SceneError: the scene is not of the task's kind.
        PlanningCancelled: `progress` asked for it.
    """
    stopwatch = _Stopwatch(clock, progress)
    if isinstance(task, PlateLiftTask) and isinstance(scene, PlateLiftScene):
        lift = plan_lift(scene, lift_settings(task.options), stopwatch)
        stopwatch.stop()
        statistics = _statistics(lift, stopwatch.seconds, **({} if lift.reserve is None else {"reserve": lift.reserve}))
        return _plan(task, scene, lift, lift_segments.plan_segments(lift, scene), statistics)
    if isinstance(task, SuctionToolTask) and isinstance(scene, SuctionToolScene):
        moved = infeasible_plan(scene) or _searched(scene, handovers, stopwatch)
        stopwatch.stop()
        reserve, considered = tool_segments.least_reserve(moved.segments), considered_by(moved)
        statistics = _statistics(moved, stopwatch.seconds, reserve=reserve, considered=considered)
        return _plan(task, scene, moved, tool_segments.plan_segments(moved.segments, scene), statistics)
    raise SceneError("/kind", f"the scene is not that of a task of kind {task.kind}")


def _plan(
    task: PlateLiftTask | SuctionToolTask,
    scene: PlateLiftScene | SuctionToolScene,
    found: LiftPlan | ToolPlan,
    segments: Iterable[Segment],
    statistics: Statistics,
) -> Plan:
    """Return the plan of a planner of either kind."""
    causes = [
        Cause(
            reason=cause.reason,
            needed=cause.needed,
            available=cause.available,
            unit=cause.unit,
            where=cause.where or cause.stage,
        )
        for cause in found.causes
    ]
    return Plan(
        schema_version=SCHEMA_VERSION,
        id="",
        # Read again, so that every default is stated.
        task=read_task(write_task(with_centres(task, scene))),
        seed=task.seed,
        software=Software(name="liftwright", version="", commit=None),
        outcome=found.outcome.value,
        explanation=Explanation(summary=found.summary, causes=causes),
        cell=scene.cell.document(),
        joint_names=list(JOINT_NAMES),
        bodies=stated_bodies(scene),
        segments=list(segments),
        certificate=None,
        simulation=None,
        statistics=statistics,
    )


def _statistics(found: LiftPlan | ToolPlan, stages: Mapping[str, float], **more: Any) -> Statistics:
    """Return what it cost; `stages` are seconds by stage, in order."""
    graph: dict[str, Any] = {**found.graph}
    search: dict[str, Any] = {**found.search}
    return Statistics(
        total_seconds=sum(stages.values()),
        stages=[StageTime(name=name, seconds=seconds) for name, seconds in stages.items()],
        graph=graph,
        search=search,
        rejections=found.rejections.counts(),
        **more,
    )


def stated_bodies(scene: PlateLiftScene | SuctionToolScene) -> dict[str, BodyDocument]:
    """Return everything in the scene, where it is at the start: bodies of the cell first, then those of the task."""
    of_task = {
        body.name: BodyDocument(
            role=body.role,
            shape=body.shape,
            mass=body.mass,
            com=body.com,
            pose=pose_row(body.T_world_body),
            static=body.static,
        )
        for body in scene.bodies()
    }
    return scene.cell.body_documents() | of_task


def lift_settings(options: PlateLiftOptions) -> LiftSettings:
    """Return the planner's settings for the options of a task."""
    settings = LiftSettings(
        minimise="force" if options.minimise == "force" else "cost",
        reserve=options.reserve,
        most_reserve=options.minimise == "risk",
        full=options.search == "full",
        sampling=ContactSampling(goal_height=options.goal_height),
    )
    return settings.scaled(options.contact_density, options.hold_density)


def _searched(scene: SuctionToolScene, handovers: HandoverSource, progress: Progress) -> ToolPlan:
    settings = ToolPlannerSettings().starting_at(scene.tool.T_world_tool)
    database = handovers(scene.cell, scene.tool, settings.handovers, progress)
    return plan_with_reserve(scene, settings, database, progress)


class _Stopwatch:
    """Passes progress on, and adds up the seconds between the first report of a stage and that of the next."""

    def __init__(self, clock: Callable[[], float], progress: Progress) -> None:
        self._clock, self._progress = clock, progress
        self._stage, self._begun = "sample", clock()
        self.seconds: dict[str, float] = {}

    def __call__(self, stage: str, done: int, total: int) -> None:
        if stage != self._stage:
            self.stop()
            self._stage = stage
        self._progress(stage, done, total)

    def stop(self) -> None:
        """Close the stage that is running."""
        now = self._clock()
        self.seconds[self._stage] = self.seconds.get(self._stage, 0.0) + now - self._begun
        self._begun = now
