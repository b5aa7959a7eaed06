"""From a scene to a plan document: the one call the service makes of the planners.

`TaskSpec -> Scene -> plan -> certify -> PlanDocument`; certifying is `planners.certify`, apart on purpose.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

from planners.contract.lift_document import lift_document
from planners.contract.task_spec import PlateLiftOptions, PlateLiftTask, SuctionToolTask
from planners.contract.tool_document import tool_document
from planners.errors import SceneError
from planners.manipulation.contacts.dense_contact_states import ContactSampling
from planners.manipulation.lift_attempts import plan_lift
from planners.manipulation.lift_settings import LiftSettings
from planners.progress import Progress
from planners.regrasp.grasps.handovers import HandoverDatabase, HandoverSettings, find_handovers
from planners.regrasp.planner import infeasible_plan
from planners.regrasp.reserve_search import plan_with_reserve
from planners.regrasp.tool_plan import ToolPlan
from planners.regrasp.tool_settings import ToolPlannerSettings
from planners.scene.cell import Cell
from planners.scene.scene import PlateLiftScene
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
) -> dict[str, Any]:
    """Plan a task; that there is no plan is an answer, with its reasons.

    Args:
        task: as accepted.
        scene: built from it.
        progress: told what is being done; may raise `PlanningCancelled`.
        clock: seconds, for the statistics only; no decision depends on it.
        handovers: asked once by a suction-tool task that may have a plan; computing them takes some seconds.

    Returns:
        The plan document, without certificate.

    Raises:
        SceneError: the scene is not of the task's kind.
        PlanningCancelled: `progress` asked for it.
    """
    stopwatch = _Stopwatch(clock, progress)
    if isinstance(task, PlateLiftTask) and isinstance(scene, PlateLiftScene):
        lift = plan_lift(scene, lift_settings(task.options), stopwatch)
        stopwatch.stop()
        return lift_document(task, scene, lift, stopwatch.seconds)
    if isinstance(task, SuctionToolTask) and isinstance(scene, SuctionToolScene):
        moved = infeasible_plan(scene) or _searched(scene, handovers, stopwatch)
        stopwatch.stop()
        return tool_document(task, scene, moved, stopwatch.seconds)
    raise SceneError("/kind", f"the scene is not that of a task of kind {task.kind}")


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
