"""From a task to its scene, its plan, and the certificate, which is made apart from the bytes that are sent."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from importlib.metadata import version
from typing import Any, Protocol

import numpy as np

from planners.cell.cell import Cell, known_cells, load_cell
from planners.certify import CellReference, Certificate, RobotSurfaces, certify, load_surfaces
from planners.contract.task_spec import PlateLiftOptions, PlateLiftTask, SuctionToolTask, read_task, write_task
from planners.errors import LiftwrightError, SceneError
from planners.geometry.pose import pose_row, to_pose7
from planners.manipulation import plan_segments as lift_segments
from planners.manipulation.contacts.dense_contact_states import ContactSampling
from planners.manipulation.lift_attempts import plan_lift
from planners.manipulation.lift_plan import LiftPlan
from planners.manipulation.lift_settings import LiftSettings
from planners.plan.plan import SCHEMA_VERSION, Plan
from planners.plan.scenery import JOINT_NAMES, BodyDocument
from planners.plan.segment import Segment
from planners.plan.verdicts import Cause, Check, Explanation, Software, StageTime, Statistics
from planners.progress import Progress, Report, silent
from planners.regrasp import plan_segments as tool_segments
from planners.regrasp.considered import considered_by
from planners.regrasp.grasps.handovers import HandoverDatabase, HandoverSettings, find_handovers
from planners.regrasp.planner import infeasible_plan
from planners.regrasp.reserve_search import plan_with_reserve
from planners.regrasp.tool_plan import ToolPlan
from planners.regrasp.tool_settings import ToolPlannerSettings
from planners.scene.lift_scene import PlateLiftScene
from planners.scene.scene import build_scene, with_centres
from planners.scene.shape_source import Uploads, no_uploads
from planners.scene.suction_tool import SuctionTool, load_tools, tool_descriptions
from planners.scene.tool_scene import SuctionToolScene


class HandoverSource(Protocol):
    """Where the handovers of a cell and a tool come from: computed, or kept from earlier."""

    def __call__(
        self, cell: Cell, tool: SuctionTool, settings: HandoverSettings, progress: Progress
    ) -> HandoverDatabase:
        """Return what `find_handovers` returns for the same arguments."""
        ...


class CertificateFailed(LiftwrightError):
    """A plan was found and did not stand its independent re-check. The fault is ours."""

    def __init__(self, plan: Plan, failures: Sequence[Check]) -> None:
        self.plan = plan
        """With its certificate: to find out why, not to be used."""
        failed = [f"{check.name} (margin {check.margin} {check.unit} at {check.where})" for check in failures]
        super().__init__(f"the plan that was found failed its certificate: {'; '.join(failed)}")


def solve(
    task: PlateLiftTask | SuctionToolTask,
    *,
    cells: Mapping[str, Cell] | None = None,
    uploads: Uploads = no_uploads,
    on_progress: Progress = silent,
) -> Plan:
    """Plan a task and certify the plan; that there is no plan is an answer, with its reasons.

    >>> from pathlib import Path
    >>> from planners import read_task, solve
    >>> task = read_task(Path("assets/tasks/pb1_weak_cup.json"))
    >>> plan = solve(task, on_progress=lambda report: None if report.done else print(report.name))
    scene
    certify
    >>> plan.outcome, plan.certificate.passed
    ('infeasible', True)

    Args:
        task: as `read_task` gives it.
        cells: by name; those that are shipped, if it is left out.
        uploads: finds the meshes that the task names as uploads.
        on_progress: told what is being done; may raise `PlanningCancelled`.

    Returns:
        The plan, without a simulation. What was not found claims nothing: its certificate is None.

    Raises:
        SceneError: the task names what cannot stand as it says.
        CertificateFailed: the plan must not be used.
        PlanningCancelled: `on_progress` asked for it.
    """
    return TaskSolver(_shipped_cells() if cells is None else cells, _shipped_tools()).solve(
        task, uploads=uploads, on_progress=on_progress
    )


@dataclass(frozen=True, eq=False)
class TaskSolver:
    """Plans and certifies tasks in the cells and with the tools that it knows."""

    cells: Mapping[str, Cell]
    tools: Mapping[str, SuctionTool]
    """By name."""
    handovers: HandoverSource = find_handovers
    """Asked once by a suction-tool task that may have a plan; computing them takes some seconds."""
    plan: Callable[..., Plan] = field(default_factory=lambda: plan)
    certify: Callable[[bytes, RobotSurfaces, CellReference], Certificate | None] = certify
    software: Software | None = None
    """What is told to have made the plan; None: this package, of no known commit."""
    clock: Callable[[], float] = time.perf_counter
    """[s], for the statistics only; no decision depends on it."""

    def solve(
        self,
        task: PlateLiftTask | SuctionToolTask,
        name: str = "",
        uploads: Uploads = no_uploads,
        on_progress: Progress = silent,
    ) -> Plan:
        """Return what `planners.solve` returns, as the plan of this name (its `id`)."""
        begun = self.clock()
        on_progress(Report("scene", 0, 1))
        scene = self.scene(task, uploads)
        on_progress(Report("scene", 1, 1))
        built = self.clock()
        found = self.plan(task, scene, on_progress, self.clock, self.handovers)
        made_by = {} if self.software is None else {"software": self.software}
        found = found.model_copy(update={"id": name, **made_by})
        planned = self.clock()
        on_progress(Report("certify", 0, 1))
        certificate = self.certify(found.write(), _surfaces(), _reference(self.cells[found.cell.name]))
        on_progress(Report("certify", 1, 1))
        certified = self.clock()
        times = [("scene", built - begun), *found.statistics.times, ("certify", certified - planned)]
        statistics = found.statistics.taking(times, certified - begun)
        found = found.model_copy(update={"certificate": certificate, "statistics": statistics})
        if certificate is not None and not certificate.passed:
            raise CertificateFailed(found, certificate.failures)
        return found

    def scene(
        self, task: PlateLiftTask | SuctionToolTask, uploads: Uploads = no_uploads
    ) -> PlateLiftScene | SuctionToolScene:
        """Return the scene of a task.

        Raises:
            SceneError: the task names what cannot stand as it says.
        """
        return build_scene(task, self.cells, uploads=uploads, tools=self.tools)


@cache
def _shipped_cells() -> Mapping[str, Cell]:
    return {name: load_cell(name) for name in known_cells()}


_shipped_tools = cache(load_tools)
_surfaces = cache(load_surfaces)
"""The robots' meshes, which the certificate checks against."""


def _reference(cell: Cell) -> CellReference:
    """Return what the certificate may take for known about a cell."""
    home = np.concatenate([cell.arms[arm].home for arm in ("left", "right")])
    rest = None if cell.tool_rest is None else to_pose7(cell.tool_rest.T_world_tool)
    return CellReference(cell.document(), cell.body_documents(), home, rest, tool_descriptions())


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
        The plan, without id and certificate.

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
        software=Software(name="liftwright", version=version("liftwright"), commit=None),
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

    def __call__(self, report: Report, /) -> None:
        if report.name != self._stage:
            self.stop()
            self._stage = report.name
        self._progress(report)

    def stop(self) -> None:
        """Close the stage that is running."""
        now = self._clock()
        self.seconds[self._stage] = self.seconds.get(self._stage, 0.0) + now - self._begun
        self._begun = now
