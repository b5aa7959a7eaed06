"""A plan of a suction-tool task with as much of every force limit kept back as was asked for, or as there can be."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from planners.plan.verdicts import PlanningOutcome
from planners.progress import Progress, Report
from planners.regrasp.grasps.handovers import HandoverDatabase
from planners.regrasp.planner import SuctionToolPlanner
from planners.regrasp.statics.hold_statics import HoldStatics
from planners.regrasp.tool_plan import ToolPlan
from planners.regrasp.tool_segment import HeldReserve
from planners.regrasp.tool_settings import ToolPlannerSettings
from planners.scene.tool_scene import SuctionToolScene

_WORTH_IT = 0.005
"""Reserves that differ by less are not told apart by another search [1]."""


@dataclass(frozen=True, eq=False)
class ReservedPlan:
    """A plan with its forces, and what it leaves of their limits."""

    plan: ToolPlan
    least: HeldReserve | None
    """Of the segment in which least is left; None where nothing is held."""

    @property
    def solved(self) -> bool:
        """Whether it is a plan."""
        return self.plan.outcome is PlanningOutcome.SOLVED

    @property
    def reserve(self) -> float:
        """The least along the plan [1]."""
        return 1.0 if self.least is None else self.least.least


def plan_with_reserve(
    scene: SuctionToolScene,
    settings: ToolPlannerSettings,
    handovers: HandoverDatabase,
    progress: Progress,
    *,
    persistent: bool = True,
) -> ToolPlan:
    """Plan a task with the reserve that it asks for; where that finds nothing, with the largest that is found.

    A plan without any reserve is looked for then, and between it and what failed a few times more, by somebody who
    gives up early: what is barely possible takes longest. That there is no plan is only said of the true limits.

    Args:
        scene: the task.
        settings: budgets and distances.
        handovers: of the scene's cell and tool.
        progress: told of what is being done; may raise to stop.
        persistent: whether anything is looked for with less than the reserve asked for.

    Returns:
        The plan, complete with contact forces and reserves.
    """

    def found_with(reserve: float, settings: ToolPlannerSettings = settings) -> ReservedPlan:
        plan = SuctionToolPlanner(scene.keeping_back(reserve), settings, handovers, progress).plan()
        progress(Report("forces", 0, 1))
        plan = replace(plan, segments=HoldStatics(scene).balanced(plan.segments))
        progress(Report("forces", 1, 1))
        held = [segment.reserve for segment in plan.segments if segment.reserve is not None]
        return ReservedPlan(plan, min(held, key=lambda each: each.least, default=None))

    wanted = scene.options.reserve
    found = found_with(wanted)
    if found.solved or wanted == 0.0 or not persistent:
        return found.plan
    found = found_with(0.0)
    if not found.solved:
        return found.plan
    hasty = settings.hasty()
    found = _largest(found, lambda reserve: found_with(reserve, hasty), wanted, settings.reserve_searches)
    if found.least is None or found.reserve >= wanted:
        return found.plan
    what = found.least.limited_by
    told = (
        f"{found.plan.summary.removesuffix('.')}; with a reserve of {found.reserve:.2g} instead of {wanted:g}: {what}."
    )
    return replace(found.plan, summary=told)


def _largest(
    found: ReservedPlan, found_with: Callable[[float], ReservedPlan], failed: float, searches: int
) -> ReservedPlan:
    """Return the plan with the largest reserve of a few searches between a plan and a reserve that has none."""
    for _ in range(searches):
        if failed - found.reserve < _WORTH_IT:
            break
        reserve = 0.5 * (found.reserve + failed)
        other = found_with(reserve)
        if other.solved:
            found = other
        else:
            failed = reserve
    return found
