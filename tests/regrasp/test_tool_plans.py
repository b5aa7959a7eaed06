"""Plans of suction-tool tasks: what every plan has to be, looked at without the planner's own bookkeeping."""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from planners.contract.task_spec import SuctionToolTask, read_task
from planners.plan.segment import SegmentKind
from planners.plan.verdicts import PlanningOutcome
from planners.progress import silent
from planners.regrasp.grasps.handovers import HandoverDatabase
from planners.regrasp.planner import SuctionToolPlanner
from planners.regrasp.tool_plan import ToolPlan
from planners.regrasp.tool_settings import ToolPlannerSettings
from planners.scene.clashes import arm_frames
from planners.scene.tool_scene import SuctionToolScene, build_tool_scene
from tests.support.plan_shelf import PlanShelf

TASKS = Path(__file__).parents[2] / "assets" / "tasks"
SETTINGS = ToolPlannerSettings()


def scene_of(name: str, **changes: object) -> SuctionToolScene:
    task = read_task({**json.loads((TASKS / f"{name}.json").read_text()), **changes})
    assert isinstance(task, SuctionToolTask)
    return build_tool_scene(task)


@pytest.fixture(scope="module")
def handovers(shelf: PlanShelf) -> HandoverDatabase:
    scene = scene_of("domino_pile")
    return shelf.handovers(scene.cell, scene.tool, SETTINGS.handovers)


@pytest.fixture(scope="module", params=["domino_pile", "can_stack", "tissue_pile"])
def planned(request: pytest.FixtureRequest, handovers: HandoverDatabase) -> tuple[SuctionToolScene, ToolPlan]:
    scene = scene_of(request.param)
    return scene, SuctionToolPlanner(scene, SETTINGS, handovers, silent).plan()


def test_every_shipped_pile_is_planned(planned: tuple[SuctionToolScene, ToolPlan]) -> None:
    scene, plan = planned
    assert plan.outcome is PlanningOutcome.SOLVED
    assert sorted(plan.order) == sorted(each.name for each in scene.objects)


def test_every_segment_begins_where_the_one_before_ended(planned: tuple[SuctionToolScene, ToolPlan]) -> None:
    scene, plan = planned
    places = {"tool": scene.tool.T_world_tool} | {each.name: each.body.T_world_body for each in scene.objects}
    for segment in plan.segments:
        for name, poses in segment.body_poses.items():
            np.testing.assert_allclose(poses[0], places[name], atol=1e-9)
            places[name] = poses[-1]
    for before, after in pairwise(plan.segments):
        np.testing.assert_allclose(after.trajectory.positions[0], before.trajectory.positions[-1], atol=1e-9)
        np.testing.assert_allclose(after.trajectory.velocities[0], before.trajectory.velocities[-1], atol=1e-9)
        for arm in after.widths:
            assert after.widths[arm][0] == before.widths[arm][-1]
    np.testing.assert_array_equal(plan.segments[0].trajectory.positions[0], scene.start_positions)


def test_what_is_held_stays_where_the_hand_holds_it(planned: tuple[SuctionToolScene, ToolPlan]) -> None:
    scene, plan = planned
    for segment in plan.segments:
        if segment.kind is not SegmentKind.TRANSFER:
            assert not segment.body_poses
            continue
        (hold,) = segment.holds
        for q, T_world_tool in zip(segment.trajectory.positions, segment.body_poses["tool"], strict=True):
            T_world_flange = arm_frames(scene.cell, q)[f"{hold.arm}/6"]
            np.testing.assert_allclose(T_world_flange @ hold.T_flange_tool, T_world_tool, atol=1e-9)


def test_every_object_ends_at_one_of_its_goals(planned: tuple[SuctionToolScene, ToolPlan]) -> None:
    scene, plan = planned
    places = {name: poses[-1] for segment in plan.segments for name, poses in segment.body_poses.items()}
    for each in scene.objects:
        assert np.abs(each.goals - places[each.name]).max(axis=(1, 2)).min() < 1e-8
    assert plan.segments[-1].sucked is None


def test_the_vacuum_goes_on_and_off_at_rest_once_for_every_object(planned: tuple[SuctionToolScene, ToolPlan]) -> None:
    _, plan = planned
    switches = [s for s in plan.segments if s.kind in (SegmentKind.ATTACH, SegmentKind.DETACH)]
    assert [s.kind for s in switches] == [SegmentKind.ATTACH, SegmentKind.DETACH] * len(plan.order)
    assert [s.sucked.name for s in switches[::2] if s.sucked] == list(plan.order)
    assert all(not s.trajectory.velocities.any() for s in switches)


@pytest.mark.slow
def test_the_same_seed_gives_the_same_plan(handovers: HandoverDatabase) -> None:
    scene = scene_of("can_stack")
    one, other = (SuctionToolPlanner(scene, SETTINGS, handovers, silent).plan() for _ in range(2))
    assert len(one.segments) == len(other.segments)
    for a, b in zip(one.segments, other.segments, strict=True):
        np.testing.assert_array_equal(a.trajectory.positions, b.trajectory.positions)


@pytest.mark.slow
def test_second_thoughts_about_slow_motion_never_make_one_object_slower(handovers: HandoverDatabase) -> None:
    objects = json.loads((TASKS / "can_stack.json").read_text())["objects"]
    scene = scene_of("can_stack", objects=objects[:1])
    seconds = []
    for thoughts in (0, 1, 4):
        settings = replace(SETTINGS, slow_motion=0.0, second_thoughts=thoughts)
        plan = SuctionToolPlanner(scene, settings, handovers, silent).plan()
        assert plan.outcome is PlanningOutcome.SOLVED
        seconds.append(sum(segment.trajectory.duration for segment in plan.segments))
    assert seconds == sorted(seconds, reverse=True)


@pytest.mark.slow
def test_others_are_tried_where_a_motion_is_longer_than_the_longest_way_to_scale(handovers: HandoverDatabase) -> None:
    objects = json.loads((TASKS / "can_stack.json").read_text())["objects"]
    scene = scene_of("can_stack", objects=objects[:1])
    plain = SuctionToolPlanner(scene, replace(SETTINGS, second_thoughts=0), handovers, silent).plan()
    longest = max(segment.trajectory.duration for segment in plain.segments)
    reach = min(arm.robot.reach for arm in scene.cell.arms.values())
    times = longest * SETTINGS.carried.speed / reach
    tried = [
        SuctionToolPlanner(scene, replace(SETTINGS, slow_motion=share * times), handovers, silent).plan()
        for share in (0.99, 1.01)
    ]
    one, other = (int(plan.search["sequences"] or 0) for plan in tried)
    assert one > other == int(plain.search["sequences"] or 0)


@pytest.mark.slow
def test_a_spent_budget_is_told_as_not_found_with_counts(handovers: HandoverDatabase) -> None:
    motion = replace(SETTINGS.motion, straight_attempts=0, max_iterations=0)
    settings = replace(SETTINGS, motion=motion, tries=3, orders=0)
    plan = SuctionToolPlanner(scene_of("can_stack"), settings, handovers, silent).plan()
    assert plan.outcome is PlanningOutcome.NOT_FOUND
    assert not plan.segments
    assert plan.causes
    assert sum(plan.rejections.counts().values()) >= 3
    # Every sequence that could not be moved costs one edge; at most one a planned object could.
    moved = int(plan.search["sequences"] or 0) - int(plan.search["edges_deleted"] or 0)
    assert 0 <= moved < int(plan.search["objects_planned"] or 0)
