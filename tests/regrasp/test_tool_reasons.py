"""Why an object is not moved, in words for whoever posted the task: which hand or arm, at which object, beside what."""

from __future__ import annotations

import math
import time
from typing import Any

import pytest

from planners import read_task
from planners.plan.verdicts import Cause
from planners.planning import plan
from planners.progress import silent
from planners.regrasp.statics.hold_statics import UNGRIPPED
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
def test_what_keeps_hands_off_the_tool_is_named_before_arms_that_do_not_reach(shelf: PlanShelf) -> None:
    wall = {"name": "wall", "shape": {"type": "box", "size": [0.3, 0.02, 0.25]}, "pose": [0.4, 0, 1.219, 1, 0, 0, 0]}
    task = read_task({"kind": "suction_tool", "objects": [PART], "obstacles": [wall]})
    found = plan(task, build_scene(task), silent, time.perf_counter, shelf.handovers, persistent=False)
    assert "wall would touch" in found.explanation.summary
    assert "wall would touch" in found.explanation.causes[0].reason


@pytest.mark.slow
def test_an_arm_that_does_not_reach_is_named(shelf: PlanShelf) -> None:
    told = reasons(shelf, [0.75, -0.6, 1.109, 1, 0, 0, 0], [])
    assert all("arm reaches all" in reason or "arm does not reach" in reason for reason in told)


@pytest.mark.slow
def test_the_squeeze_that_is_missing_is_told_in_newtons_and_with_it_some_grasp_bears_the_tool(shelf: PlanShelf) -> None:
    """A tall carton that is laid on its side: sucked at a side, it hangs far from the fingers."""
    carton = {
        "name": "tall", "shape": {"type": "box", "size": [0.3, 0.2, 0.35]}, "mass": 1.5,
        "pose": [0.5, 0.35, 0.975, 1, 0, 0, 0], "goal_pose": [0.55, -0.2, 0.95, math.sqrt(0.5), 0, math.sqrt(0.5), 0],
    }  # fmt: skip
    body = {"kind": "suction_tool", "cell": "dual_ur5e_tool", "tool": "carton_lifter", "objects": [carton]}

    def missing(grip_force_limit: float) -> list[Cause]:
        task = read_task({**body, "grip_force_limit": grip_force_limit})
        found = plan(task, build_scene(task), silent, time.perf_counter, shelf.handovers, persistent=False)
        return [cause for cause in found.explanation.causes if f"at its start: {UNGRIPPED}" in cause.reason]

    (cause,) = missing(60.0)
    assert (cause.unit, cause.where) == ("N", "tall")
    assert cause.needed is not None
    assert cause.available is not None
    # Fingers press with their squeeze and half of what the hand bears: the limit is as much larger.
    assert missing(60.0 + cause.needed - cause.available - 1.0)
    assert not missing(60.0 + cause.needed - cause.available + 1.0)
