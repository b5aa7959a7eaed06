"""Weights and widths that prove a suction-tool task to have no plan."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest

from planners.geometry.convex import ConvexShape
from planners.progress import silent
from planners.regrasp.grasps import ToolGrasps
from planners.regrasp.handovers import HandoverDatabase
from planners.regrasp.planner import SuctionToolPlanner
from planners.regrasp.suction_hold import suction_margin
from planners.regrasp.tool_capacity import largest_lift, least_width
from planners.regrasp.tool_plan import ToolOutcome
from planners.regrasp.tool_settings import ToolPlannerSettings
from planners.scene.cell import Cell
from planners.scene.suction_tool import SuctionTool
from tests.regrasp.tool_tasks import box, scene_of


@dataclass(frozen=True)
class SomeCup:
    radius: float = 0.02
    max_force: float = 30.0
    mu: float = 0.5
    kappa: float = 1e3


@pytest.mark.parametrize("mu", [0.3, 0.9, 2.0])
def test_no_wrench_within_the_cones_has_more_along_any_direction_than_the_largest_lift(mu: float) -> None:
    cup, rng = SomeCup(mu=mu), np.random.default_rng(1)
    forces = rng.uniform(-1.0, 1.0, (40000, 3)) * cup.max_force * max(1.0, mu)
    wrenches = np.hstack([forces, np.zeros((40000, 3))])
    held = suction_margin(wrenches, cup) >= 0.0
    assert held.sum() > 20
    assert np.linalg.norm(forces[held], axis=1).max() <= largest_lift(cup)


def test_the_least_width_of_a_body_is_that_of_its_slimmest_direction() -> None:
    rng = np.random.default_rng(2)
    directions = rng.normal(size=(20000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    for _ in range(5):
        vertices = rng.normal(size=(7, 3))
        width = least_width(ConvexShape(vertices, 0.1))
        sampled = float(np.ptp(vertices @ directions.T, axis=0).min()) + 0.2
        assert width <= sampled + 1e-12
        assert width == pytest.approx(sampled, abs=0.03)


def planner_of(scene, handovers=None) -> SuctionToolPlanner:
    return SuctionToolPlanner(scene, ToolPlannerSettings(), handovers, silent)


def none_for(cell: Cell, tool: SuctionTool) -> HandoverDatabase:
    empty = np.zeros((0, 0), np.uint8)
    grasps = ToolGrasps(np.empty((0, 4, 4)), np.empty(0), np.empty(0), ())
    return HandoverDatabase(
        "none", grasps, np.zeros(3), np.empty((0, 4, 4)), empty, empty, np.zeros((0, 0, 0), np.uint8)
    )


def test_what_is_too_heavy_for_the_cup_is_infeasible_with_both_numbers() -> None:
    scene = scene_of(box("block", [0.3, 0.3], [0.3, -0.3], mass=2.2))
    plan = planner_of(scene, none_for(scene.cell, scene.tool)).plan()
    assert plan.outcome is ToolOutcome.INFEASIBLE
    cause = plan.causes[0]
    assert cause.needed == pytest.approx(2.2 * 9.81)
    assert cause.available == pytest.approx(scene.tool.cup.max_force)
    assert cause.unit == "N"


def test_what_the_cup_bears_and_no_hand_may_carry_with_the_tool_is_infeasible_with_both_numbers() -> None:
    left = 3.0 - 0.300 - 0.905
    scene = scene_of(box("block", [0.3, 0.3], [0.3, -0.3], mass=1.001 * left - 0.25))
    plan = planner_of(scene, none_for(scene.cell, scene.tool)).plan()
    assert plan.outcome is ToolOutcome.INFEASIBLE
    (cause,) = plan.causes
    assert "payload" in cause.reason
    assert (cause.needed, cause.available, cause.unit) == (
        pytest.approx(1.001 * left * 9.81), pytest.approx(left * 9.81), "N",
    )  # fmt: skip


def test_what_one_of_two_hands_may_carry_is_not_proven_impossible() -> None:
    scene = scene_of(box("block", [0.3, 0.3], [0.3, -0.3], mass=1.5))
    weaker = replace(scene, carry_force_limits=scene.carry_force_limits | {"left": 1.0})
    assert planner_of(weaker, none_for(scene.cell, scene.tool)).plan().outcome is ToolOutcome.NOT_FOUND


def test_what_is_too_heavy_and_at_its_goal_already_stays_there() -> None:
    scene = scene_of(box("block", [0.3, 0.3], [0.3, 0.3], mass=20.0))
    assert planner_of(scene, none_for(scene.cell, scene.tool)).plan().outcome is ToolOutcome.SOLVED


def test_a_tool_that_no_grasp_was_found_for_is_not_proven_impossible() -> None:
    scene = scene_of(box("block", [0.3, 0.3], [0.3, -0.3]))
    plan = planner_of(scene, none_for(scene.cell, scene.tool)).plan()
    assert plan.outcome is ToolOutcome.NOT_FOUND
    assert plan.causes


def test_fingers_that_may_hardly_squeeze_prove_a_task_impossible() -> None:
    scene = replace(scene_of(box("block", [0.3, 0.3], [0.3, -0.3])), grip_force_limit=0.5)
    plan = planner_of(scene, none_for(scene.cell, scene.tool)).plan()
    assert plan.outcome is ToolOutcome.INFEASIBLE
    assert [cause.unit for cause in plan.causes] == ["N"]
