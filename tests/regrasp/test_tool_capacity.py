"""Weights and widths that prove a suction-tool task to have no plan."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import pytest

from planners.cell.cell import Cell
from planners.contract.task_spec import read_task
from planners.plan.verdicts import PlanningOutcome
from planners.planning import plan
from planners.progress import silent
from planners.regrasp.grasps.handovers import HandoverDatabase
from planners.regrasp.grasps.tool_grasps import ToolGrasps
from planners.regrasp.planner import SuctionToolPlanner, _has_to_move, infeasible_plan
from planners.regrasp.suction.suction_hold import suction_margin
from planners.regrasp.tool_capacity import largest_lift
from planners.regrasp.tool_settings import ToolPlannerSettings
from planners.scene.scene import build_scene
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


def planner_of(scene, handovers=None) -> SuctionToolPlanner:
    return SuctionToolPlanner(scene, ToolPlannerSettings(), handovers, silent)


def none_for(cell: Cell, tool: SuctionTool) -> HandoverDatabase:
    empty = np.zeros((0, 0), np.uint8)
    return HandoverDatabase(
        "none", ToolGrasps.none(), np.zeros(3), np.empty((0, 4, 4)), empty, empty, np.zeros((0, 0, 0), np.uint8)
    )


def test_what_is_too_heavy_for_the_cup_is_infeasible_with_both_numbers() -> None:
    scene = scene_of(box("block", [0.3, 0.3], [0.3, -0.3], mass=2.2))
    plan = infeasible_plan(scene)
    assert plan is not None
    assert plan.outcome is PlanningOutcome.INFEASIBLE
    cause = plan.causes[0]
    assert cause.needed == pytest.approx(2.2 * 9.81)
    assert cause.available == pytest.approx(scene.tool.cup.max_force)
    assert cause.unit == "N"


def test_what_the_cup_bears_and_no_hand_may_carry_with_the_tool_is_infeasible_with_both_numbers() -> None:
    left = 3.0 - 0.300 - 0.905
    scene = scene_of(box("block", [0.3, 0.3], [0.3, -0.3], mass=1.001 * left - 0.25))
    plan = infeasible_plan(scene)
    assert plan is not None
    assert plan.outcome is PlanningOutcome.INFEASIBLE
    (cause,) = plan.causes
    assert "payload" in cause.reason
    assert (cause.needed, cause.available, cause.unit) == (
        pytest.approx(1.001 * left * 9.81), pytest.approx(left * 9.81), "N",
    )  # fmt: skip


def test_what_one_of_two_hands_may_carry_is_not_proven_impossible() -> None:
    scene = scene_of(box("block", [0.3, 0.3], [0.3, -0.3], mass=1.5))
    weaker = replace(scene, carry_force_limits=scene.carry_force_limits | {"left": 1.0})
    assert infeasible_plan(weaker) is None


def test_what_is_too_heavy_and_at_its_goal_already_stays_there() -> None:
    scene = scene_of(box("block", [0.3, 0.3], [0.3, 0.3], mass=20.0))
    assert infeasible_plan(scene) is None
    assert planner_of(scene, none_for(scene.cell, scene.tool)).plan().outcome is PlanningOutcome.SOLVED


@pytest.mark.parametrize("degrees", [7.5, 0.3, 352.0, 101.0])
def test_a_turn_that_the_goal_does_not_tell_apart_moves_nothing_and_any_other_does(degrees: float) -> None:
    turned, goal, aside = [0.3, 0.3, math.radians(degrees)], [0.3, 0.3], [0.3, -0.3]
    can = {"shape": {"type": "cylinder", "radius": 0.04, "height": 0.05}}
    beside = box("beside", aside, [0.3, 0.3805])
    for stays, objects in (
        (True, [box("can", turned, goal, goal_symmetry="axis", **can)]),
        (True, [box("can", turned, goal, goal_symmetry="shape", **can)]),
        (False, [box("can", turned, goal, goal_symmetry="none", **can)]),
        (True, [box("block", turned, goal, goal_symmetry="axis")]),
        (False, [box("block", turned, goal, goal_symmetry="shape")]),
        # Turned like this it would be in the way of what is to stand beside it.
        (False, [box("block", turned, goal, goal_symmetry="axis"), beside]),
    ):
        scene = scene_of(*objects)
        assert _has_to_move(scene, scene.objects[0]) is not stays


def test_a_tool_that_no_grasp_was_found_for_is_not_proven_impossible() -> None:
    scene = scene_of(box("block", [0.3, 0.3], [0.3, -0.3]))
    assert infeasible_plan(scene) is None
    plan = planner_of(scene, none_for(scene.cell, scene.tool)).plan()
    assert plan.outcome is PlanningOutcome.NOT_FOUND
    assert plan.causes


def test_fingers_that_may_hardly_squeeze_prove_a_task_impossible() -> None:
    scene = replace(scene_of(box("block", [0.3, 0.3], [0.3, -0.3])), grip_force_limit=0.5)
    plan = infeasible_plan(scene)
    assert plan is not None
    assert plan.outcome is PlanningOutcome.INFEASIBLE
    assert [cause.unit for cause in plan.causes] == ["N"]


def test_a_task_that_is_proven_impossible_asks_for_no_handovers() -> None:
    """To compute them for a tool takes seconds, and no search needs them."""

    def never(*_: object) -> HandoverDatabase:
        return pytest.fail("handovers were asked for")

    block = box("block", [0.3, 0.3], [0.3, -0.3], mass=20.0)
    task = read_task({"kind": "suction_tool", "objects": [block]})
    document = plan(task, build_scene(task), silent, lambda: 0.0, never).document()
    assert document["outcome"] == "infeasible"
    assert {cause["unit"] for cause in document["explanation"]["causes"]} == {"N"}


FAR = [1.45, 0.0]
SHELF = {"name": "shelf", "shape": {"type": "box", "size": [0.4, 0.4, 0.2]}, "pose": [*FAR, 0.994, 1, 0, 0, 0]}
"""A shelf as high as the table, half a metre behind it."""


@pytest.mark.parametrize(
    ("start", "goal", "where"), [([0.3, 0.3], FAR, "at its goal"), (FAR, [0.3, 0.3], "where it is")]
)
def test_what_no_arm_reaches_with_the_tool_is_infeasible_with_both_lengths(
    start: list[float], goal: list[float], where: str
) -> None:
    scene = scene_of(box("block", start, goal), obstacles=[SHELF])
    plan = infeasible_plan(scene)
    assert plan is not None
    assert plan.outcome is PlanningOutcome.INFEASIBLE
    (cause,) = plan.causes
    assert (cause.stage, cause.where, cause.unit) == ("reach", "block", "m")
    assert where in cause.reason
    shoulder = np.array([0.0, 0.258485, 1.610515]) + 0.15185 * np.array([0.0, 1.0, -1.0]) / np.sqrt(2.0)
    far = np.linalg.norm([FAR[0], shoulder[1], 1.094 + 0.025 - shoulder[2]])
    assert cause.needed == pytest.approx(far, abs=1e-6)
    assert cause.available < cause.needed


def test_a_tool_that_no_arm_reaches_is_infeasible() -> None:
    scene = scene_of(box("block", [0.3, 0.3], [0.3, -0.3]), obstacles=[SHELF], tool_pose=[*FAR, 1.094, 1, 0, 0, 0])
    plan = infeasible_plan(scene)
    assert plan is not None
    assert plan.outcome is PlanningOutcome.INFEASIBLE
    assert [(cause.stage, cause.where) for cause in plan.causes] == [("reach", "tool")]


def test_what_is_out_of_reach_and_at_its_goal_already_stays_there() -> None:
    scene = scene_of(box("block", FAR, FAR), obstacles=[SHELF])
    assert planner_of(scene, none_for(scene.cell, scene.tool)).plan().outcome is PlanningOutcome.SOLVED
