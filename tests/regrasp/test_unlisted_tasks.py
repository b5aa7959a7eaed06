"""Objects, goals and obstacles that no shipped task has: planned, or refused with reasons."""

from __future__ import annotations

import itertools
import json
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from planners.plan.verdicts import PlanningOutcome
from planners.progress import silent
from planners.regrasp.graph.regrasp_figures import EdgeState, LayerName, RegraspEdgeKind
from planners.regrasp.grasps.handovers import HandoverDatabase
from planners.regrasp.pile.pile_planner import SuctionFinder
from planners.regrasp.pile.stopover import Stopovers
from planners.regrasp.planner import SuctionToolPlanner
from planners.regrasp.statics.hold_statics import HoldStatics
from planners.regrasp.tool_plan import ToolPlan
from planners.regrasp.tool_settings import StopoverSettings, ToolPlannerSettings
from planners.scene.clashes import gap, placed_body
from planners.scene.tool_placements import StillBodies
from planners.scene.tool_scene import SuctionToolScene
from tests.regrasp.tool_tasks import box, pose, scene_of

ANGLE = {"type": "prism", "outline": [[-0.06, -0.05], [0.06, -0.05], [0.06, 0.05], [-0.06, 0.05]], "height": 0.03}
TALL = {"shape": {"type": "cylinder", "radius": 0.03, "height": 0.12}, "goal_symmetry": "axis"}


@pytest.fixture
def handovers(long_handovers: HandoverDatabase) -> HandoverDatabase:
    return long_handovers


def planned(scene: SuctionToolScene, handovers: HandoverDatabase) -> ToolPlan:
    plan = SuctionToolPlanner(scene, ToolPlannerSettings(), handovers, silent).plan()
    if plan.segments:
        # Raises where cup or fingers give way, or an object would tip over where it is put down.
        HoldStatics(scene).balanced(plan.segments)
    return plan


TASKS = {
    "a cylinder that changes sides": [box("can", [0.32, 0.3], [0.32, -0.3], (0.06, 0.06, 0.12), **TALL)],
    "a box onto another": [
        box("low", [0.3, 0.3], [0.4, 0.0], (0.16, 0.12, 0.04)),
        box("high", [0.3, -0.3], [0.4, 0.0, 0.5, 0.04], (0.1, 0.07, 0.06)),
    ],
    "a prism that turns": [box("part", [0.4, 0.25], [0.35, 0.1, 1.2], (0.12, 0.1, 0.03), shape=ANGLE)],
}


@pytest.mark.parametrize("objects", TASKS.values(), ids=TASKS.keys())
def test_objects_nobody_listed_end_at_one_of_their_goals(objects: list, handovers: HandoverDatabase) -> None:
    scene = scene_of(*objects)
    plan = planned(scene, handovers)
    assert plan.outcome is PlanningOutcome.SOLVED, plan.causes
    places = {name: poses[-1] for segment in plan.segments for name, poses in segment.body_poses.items()}
    for each in scene.objects:
        assert np.abs(each.goals - places[each.name]).max(axis=(1, 2)).min() < 1e-8


@pytest.mark.slow
def test_objects_that_stand_on_each_others_goals_change_places_by_way_of_a_third(handovers: HandoverDatabase) -> None:
    scene = scene_of(box("one", [0.35, 0.2], [0.35, -0.2]), box("other", [0.35, -0.2], [0.35, 0.2]))
    plan = planned(scene, handovers)
    assert plan.outcome is PlanningOutcome.SOLVED, plan.causes
    assert sorted(Counter(plan.order).values()) == [1, 2]
    assert "put aside" in plan.summary


def test_what_only_one_arm_may_carry_is_carried_by_that_arm(handovers: HandoverDatabase) -> None:
    """The left arm is on the object's side and may take the tool; with the object it is more than it may carry."""
    scene = scene_of(box("heavy", [0.35, 0.15], [0.35, 0.05], mass=0.5))
    weak = replace(scene, carry_force_limits={"left": 5.0, "right": 17.6})
    plan = planned(weak, handovers)
    assert plan.outcome is PlanningOutcome.SOLVED, plan.causes
    laden = [segment for segment in plan.segments if segment.sucked is not None]
    assert laden
    assert {hold.arm for segment in laden for hold in segment.holds} == {"right"}


@pytest.mark.slow
def test_a_stopover_is_clear_of_everything_now_and_later() -> None:
    obstacle = {"name": "post", "shape": {"type": "box", "size": [0.05, 0.05, 0.2]}, "pose": pose([0.45, -0.3], 0.1)}
    scene = scene_of(
        box("one", [0.35, 0.2], [0.35, -0.2]), box("other", [0.35, -0.2], [0.35, 0.2]), obstacles=[obstacle]
    )
    one, other = scene.objects
    still, settings = StillBodies.of(scene.cell, scene.obstacles), StopoverSettings()
    others = [(other.body, other.body.T_world_body), (other.body, other.T_world_goal)]
    upright, *turned = Stopovers(still, settings).targets(one, others)
    assert len(turned) == 5
    around = [placed_body(body.collision_body(), T, None) for body, T in others]
    around += [body for body in still.bodies if body.name != "table"]
    for T in np.concatenate([target.goals for target in (upright, *turned)]):
        standing = placed_body(one.body.collision_body(), T, None)
        assert min(gap(standing, body) for body in around) >= min(settings.clearances) - 1e-9


def test_the_suction_poses_are_asked_once_for_every_object() -> None:
    scene = scene_of(box("one", [0.35, 0.2], [0.35, -0.2]))
    told: list[str] = []
    finder = SuctionFinder(
        scene.tool.cup, scene.cell.gravity, ToolPlannerSettings().suction, lambda report: told.append(report.name)
    )
    assert finder.to_goal(scene.objects[0]) is finder.to_goal(scene.objects[0])
    assert told == ["suction one"]


@pytest.mark.slow
def test_an_object_that_is_out_of_reach_is_not_found_with_the_reason(handovers: HandoverDatabase) -> None:
    plan = planned(scene_of(box("far", [0.8, 0.8], [0.35, 0.2])), handovers)
    assert plan.outcome is PlanningOutcome.NOT_FOUND
    assert any("arm reaches" in cause.reason or "arm does not reach" in cause.reason for cause in plan.causes)


def test_the_figures_of_a_regrasp_graph_show_the_sequence_that_was_moved(handovers: HandoverDatabase) -> None:
    plan = planned(scene_of(box("block", [0.4, 0.35], [0.4, -0.35])), handovers)
    (figures,) = plan.regrasp
    assert figures.moved
    chosen = [figures.edges[number] for number in figures.sequence]
    assert all(edge.state is EdgeState.CHOSEN for edge in chosen)
    assert [edge.kind for edge in chosen].count(RegraspEdgeKind.PICK) == 1
    assert all(before.end == after.start for before, after in itertools.pairwise(chosen))
    assert sum(edge.kind is RegraspEdgeKind.HANDOVER for edge in chosen) == plan.search["handovers"]
    layers = {(layer.layer, layer.goal): set(layer.possible) for layer in figures.layers}
    assert chosen[0].end in layers[LayerName.INITIAL, None]
    (first, second) = [edge for edge in chosen if edge.kind is RegraspEdgeKind.TRANSFER]
    assert first.end in layers[LayerName.SUCTION, None]
    assert second.end in layers[LayerName.GOAL, second.goal]
    for layer in figures.layers:
        rejected = [node for nodes in layer.rejected.values() for node in nodes]
        assert len(rejected) == len(set(rejected))
        assert not set(rejected) & set(layer.possible)
    written = [[list(layer.possible), *map(list, layer.rejected.values())] for layer in figures.layers]
    assert len(json.dumps(written)) < 50_000
