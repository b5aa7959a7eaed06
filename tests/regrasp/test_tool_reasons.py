"""Why an object is not moved, in words for whoever posted the task: which hand or arm, at which object, beside what."""

from __future__ import annotations

import time
from typing import Any

import pytest

from planners import read_task
from planners.planning import plan
from planners.progress import silent
from planners.scene.scene import build_scene
from tests.support.deep_bin import PART, WALLS
from tests.support.plan_shelf import PlanShelf


def reasons(shelf: PlanShelf, goal: list[float], walls: list[dict[str, Any]]) -> list[str]:
    """Return why a part is not moved to a goal among walls, if it is looked for once."""
    task = read_task({"kind": "suction_tool", "objects": [{**PART, "goal_pose": goal}], "obstacles": walls})
    found = plan(task, build_scene(task), silent, time.perf_counter, shelf.handovers, persistent=False)
    assert found.outcome == "not_found"
    causes = [cause for cause in found.explanation.causes if cause.reason.startswith("No grasp has the tool")]
    assert causes
    assert all("part" in cause.reason and cause.where == "part" for cause in causes)
    return [cause.reason for cause in causes]


@pytest.mark.slow
def test_what_a_hand_would_touch_is_named_though_most_grasps_are_out_of_reach(shelf: PlanShelf) -> None:
    told = reasons(shelf, PART["goal_pose"], WALLS)
    assert all("the right hand and wall_" in reason for reason in told)
    assert not any("branch" in reason for reason in told)


@pytest.mark.slow
def test_an_arm_that_does_not_reach_is_named(shelf: PlanShelf) -> None:
    told = reasons(shelf, [0.75, -0.6, 1.109, 1, 0, 0, 0], [])
    assert all("arm reaches all" in reason or "arm does not reach" in reason for reason in told)
