"""The cell's left and right are mirror images: so are grasps, handovers, places, and what comes of mirrored tasks.

A tool that is its own mirror image in its x-z plane, as both shipped ones are, is at `M T M` in the mirrored task.
"""

from __future__ import annotations

import copy
from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from planners.geometry.pose import rotation_x, rotation_y, rotation_z, to_pose7, transform
from planners.progress import silent
from planners.regrasp.grasps.grasp_reach import GraspReach, GraspSurroundings
from planners.regrasp.grasps.tool_grasps import Fingertips, ToolGrasps, ToolGraspSettings, tool_grasps
from planners.regrasp.pile.pile_planner import SuctionFinder
from planners.regrasp.pile.stopover import Stopovers
from planners.regrasp.planner import SuctionToolPlanner
from planners.regrasp.tool_plan import ToolPlan
from planners.regrasp.tool_settings import ToolPlannerSettings
from planners.regrasp.tool_workcell import ToolWorkcell
from planners.scene.suction_tool import SuctionTool
from planners.scene.tool_placements import StillBodies
from planners.scene.tool_scene import SuctionToolScene
from tests.regrasp.tool_tasks import TABLE, box, scene_of
from tests.support.samples import among

M = np.diag([1.0, -1.0, 1.0, 1.0])
"""Mirrors at the x-z plane; on both sides of a pose, so that it stays one."""
OTHER = {"left": "right", "right": "left"}
HULLS = 0.01
"""Share of verdicts that may differ: the meshes of the arms' links are not quite their own mirror images."""
DOWN = np.array([0.0, 0.0, -9.81])
SETTINGS = ToolPlannerSettings()


def mirrored(objects: Iterable[dict[str, Any]]) -> list[dict[str, Any]]:
    """Mirror objects that are their own mirror images in their x-z planes."""
    images = copy.deepcopy(list(objects))
    for each in images:
        for member in ("pose", "goal_pose"):
            x, y, z, qw, qx, qy, qz = each[member]
            each[member] = [x, -y, z, qw, -qx, qy, -qz]
    return images


def image_numbers(grasps: ToolGrasps) -> np.ndarray:
    """Return the number of each grasp's mirror image (n,); fingers are told apart, so that a hand's y turns over."""
    keys = [tuple(row) for row in _rows(grasps.T_tool_tcp)]
    numbers = {key: number for number, key in enumerate(keys)}
    return np.array([numbers[tuple(row)] for row in _rows(M @ grasps.T_tool_tcp @ M)])


def _rows(poses: np.ndarray) -> list[list[float]]:
    # Contacts lie on a grid that is shifted by a hair.
    return (poses[:, :3].reshape(len(poses), 12).round(4) + 0.0).tolist()


@pytest.fixture(params=["long", "short"])
def tool(request, long_tool, short_tool) -> SuctionTool:
    return {"long": long_tool, "short": short_tool}[request.param]


@pytest.fixture(params=[None, Fingertips()], ids=["standing", "lying"])
def grasps(request, tool, gripper) -> ToolGrasps:
    return tool_grasps(tool, gripper, replace(ToolGraspSettings(), fingertips=request.param))


def test_every_grasp_has_its_mirror_image_among_the_grasps(grasps):
    numbers = image_numbers(grasps)
    assert sorted(numbers) == list(range(len(grasps)))
    np.testing.assert_allclose(grasps.widths[numbers], grasps.widths, atol=1e-9)


def test_the_other_arm_reaches_the_mirror_images_of_what_one_arm_reaches(cell, tool, grasps):
    workcell, rng = ToolWorkcell(cell, tool), np.random.default_rng(4)
    numbers, lift = image_numbers(grasps), np.array([0.0, 0.0, 0.05])
    reach = {
        arm: GraspReach(workcell, arm, grasps, GraspSurroundings({}, None, 0.085), ToolGraspSettings()) for arm in OTHER
    }
    reached = differing = 0
    for _ in range(8):
        # Up to and beyond where the arms reach.
        place = [rng.uniform(0.2, 0.65), rng.uniform(-0.1, 0.5), TABLE + rng.uniform(0.02, 0.2)]
        T = transform(rotation_z(rng.uniform(-np.pi, np.pi)) @ rotation_x(rng.choice([0.0, 1.5])), place)
        left, right = reach["left"].branches(T, lift), reach["right"].branches(M @ T @ M, lift)
        reached += int((left > 0).sum())
        differing += int(((left > 0) != (right[numbers] > 0)).sum())
    assert reached > 100
    assert differing <= HULLS * reached


@pytest.mark.parametrize("which", ["long", "short"])
def test_handovers_are_mirror_images(which, request):
    base = request.getfixturevalue(f"{which}_handovers")
    assert base.place[1] == pytest.approx(0.0, abs=1e-6)
    numbers = image_numbers(base.grasps)
    differing = 0
    for T, pairs in zip(base.T_world_tool, base.compatible, strict=True):
        distances = np.abs(base.T_world_tool - M @ T @ M).max(axis=(1, 2))
        image = int(np.argmin(distances))
        assert distances[image] < 1e-6
        # What the left hand does here, the right hand does there.
        differing += int((pairs != base.compatible[image][np.ix_(numbers, numbers)].T).sum())
    assert differing <= HULLS * base.compatible.sum()


OBJECTS = {
    "a box beside the middle": [box("a", [0.5, 0.3, 0.4], [0.4, -0.1, 1.0], (0.13, 0.07, 0.02))],
    "a square one in the middle": [box("a", [0.4, 0.0], [0.3, 0.2], (0.09, 0.09, 0.05))],
    "one that is laid on its side": [
        box("a", [0.45, 0.25, -0.3], [0.4, -0.2], (0.1, 0.08, 0.05), goal_symmetry="none")
        | {"goal_pose": to_pose7(transform(rotation_z(0.3) @ rotation_y(np.pi / 2), [0.4, -0.2, TABLE + 0.05]))}
    ],
}


@pytest.mark.parametrize("objects", OBJECTS.values(), ids=OBJECTS.keys())
def test_places_of_the_cup_come_in_the_same_order_on_mirror_images(objects):
    tools = []
    for these in (objects, mirrored(objects)):
        (moved,) = scene_of(*these).objects
        finder = SuctionFinder(scene_of(*these).tool.cup, DOWN, SETTINGS.suction, silent)
        tools.append([moved.body.T_world_body @ each.T_object_tool for each in finder.to_goal(moved).poses])
    assert len(tools[0]) > 8
    np.testing.assert_allclose(M @ np.array(tools[0]) @ M, tools[1], atol=1e-5)


@pytest.mark.parametrize("objects", OBJECTS.values(), ids=OBJECTS.keys())
def test_stopovers_come_in_the_same_order_on_mirror_images(objects):
    places = []
    for these in (objects, mirrored(objects)):
        scene = scene_of(*these)
        stopovers = Stopovers(StillBodies.of(scene.cell, ()), SETTINGS.stopover)
        places.append([stopover.goals for stopover in stopovers.targets(scene.objects[0], [])])
    assert len(places[0]) > 1
    for one, other in zip(*places, strict=True):
        # A box is its own mirror image after half a turn of its body frame too, which laying it down may add.
        np.testing.assert_allclose((M @ one)[:, :3, 3], other[:, :3, 3], atol=1e-6)


def outcome(plan: ToolPlan, *, turned_over: bool) -> tuple[Any, ...]:
    """Return what mirrored tasks have in common: how it ended, what was moved, and which arms did it."""
    arms = tuple(OTHER[step.arm] if turned_over else step.arm for step in plan.steps)
    return plan.outcome, plan.order, tuple((step.object, step.round, step.by) for step in plan.steps), arms


def both(objects: list[dict[str, Any]], handovers: Any, **more: Any) -> list[tuple[Any, ...]]:
    plans = [_planned(scene_of(*these, **more), handovers) for these in (objects, mirrored(objects))]
    return [outcome(plans[0], turned_over=False), outcome(plans[1], turned_over=True)]


def _planned(scene: SuctionToolScene, handovers: Any) -> ToolPlan:
    return SuctionToolPlanner(scene, SETTINGS, handovers, silent).plan()


TASKS = {
    "far out, and back": [box("a", [0.58, 0.4], [0.45, 0.25], (0.13, 0.07, 0.02))],
    "far out, across": [box("a", [0.56, 0.36], [0.35, -0.2, 0.5], (0.1, 0.08, 0.05))],
    "beyond reach": [box("a", [0.7, 0.5], [0.45, 0.25])],
    "two": [box("a", [0.5, 0.3], [0.4, -0.05]), box("b", [0.3, -0.3, 0.6], [0.45, 0.2])],
}


@pytest.mark.parametrize("which", among(["long", "short"], ["long"]))
@pytest.mark.parametrize("name", among(TASKS, ["far out, and back"]))
@pytest.mark.slow
def test_mirrored_tasks_have_mirrored_outcomes(name, which, request):
    tool = {"long": "long_symmetric", "short": "short_asymmetric"}[which]
    one, other = both(TASKS[name], request.getfixturevalue(f"{which}_handovers"), tool=tool)
    assert one[:3] == other[:3]
    assert one[3] == other[3]


@pytest.mark.slow
@pytest.mark.parametrize("y", [0.36, 0.44])
def test_at_the_limit_of_reach_too(y, long_handovers):
    """From one far corner to the other, by way of a stopover: solved on one side alone before."""
    far = box("a", [0.58, y], [0.58, -y], (0.13, 0.07, 0.02), goal_symmetry="none")
    one, other = both([far], long_handovers)
    assert one == other
