"""How far an object is from its goal, as shares of what the contract allows."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from planners.contract.task_spec import read_task
from planners.geometry.pose import rotation_x, rotation_z, transform
from planners.scene.moved_object import MovedObject
from planners.scene.scene import build_scene
from planners.scene.tool_scene import SuctionToolScene

BOX = {"type": "box", "size": [0.1, 0.08, 0.06]}
CAN = {"type": "cylinder", "radius": 0.03, "height": 0.06}
DEGREE = math.radians(1.0)


def placed(shape: dict[str, Any], symmetry: str, goal_lift: float = 0.0) -> MovedObject:
    pose = [0.45, 0.0, 1.124, 1, 0, 0, 0]
    goal = [0.45, 0.0, 1.124 + goal_lift, 1, 0, 0, 0]
    one = {"name": "one", "shape": shape, "mass": 0.1, "pose": pose, "goal_pose": goal, "goal_symmetry": symmetry}
    scene = build_scene(read_task({"kind": "suction_tool", "objects": [one]}))
    assert isinstance(scene, SuctionToolScene)
    return scene.objects[0]


@pytest.mark.parametrize("shape", [BOX, CAN], ids=["box", "can"])
@pytest.mark.parametrize("symmetry", ["none", "axis", "shape"])
def test_a_way_counts_by_the_millimetre_and_a_tilt_by_the_half_degree(shape: dict[str, Any], symmetry: str) -> None:
    moved = placed(shape, symmetry)
    goal = moved.T_world_goal
    assert moved.off_goal(goal) == pytest.approx(0.0, abs=1e-6)
    assert moved.off_goal(transform(None, [0.0003, -0.0004, 0.0]) @ goal) == pytest.approx(0.5)
    assert moved.off_goal(goal @ transform(rotation_x(0.3 * DEGREE))) == pytest.approx(0.6)
    assert moved.off_goal(transform(None, [0.0009, 0.0, 0.0]) @ goal @ transform(rotation_x(DEGREE))) == pytest.approx(
        2.0
    )


@pytest.mark.parametrize(
    ("shape", "symmetry", "turned"),
    [
        (BOX, "none", (14.0, 360.0, 362.0)),
        (BOX, "axis", (0.0, 0.0, 0.0)),
        (BOX, "shape", (14.0, 0.0, 2.0)),
        (CAN, "axis", (0.0, 0.0, 0.0)),
        (CAN, "shape", (0.0, 0.0, 0.0)),
    ],
)
def test_a_turn_counts_from_the_nearest_that_the_goal_does_not_tell_apart(
    shape: dict[str, Any], symmetry: str, turned: tuple[float, ...]
) -> None:
    moved = placed(shape, symmetry)
    for degrees, share in zip((7.0, 180.0, 181.0), turned, strict=True):
        # An angle of more than 180 degrees is less the other way round.
        least = min(share, 720.0 - share)
        found = moved.off_goal(moved.T_world_goal @ transform(rotation_z(degrees * DEGREE)))
        assert found == pytest.approx(least, abs=1e-5)


def test_upside_down_is_as_good_only_where_the_shape_is() -> None:
    flip = transform(rotation_x(math.pi))
    for shape in (BOX, CAN):
        for symmetry, far in (("none", True), ("axis", True), ("shape", False)):
            moved = placed(shape, symmetry)
            assert (moved.off_goal(moved.T_world_goal @ flip) > 1.0) == far


def test_the_goal_is_the_one_that_is_given_not_the_one_it_is_settled_to() -> None:
    moved = placed(BOX, "none", goal_lift=0.0008)
    np.testing.assert_allclose(moved.T_world_goal, moved.body.T_world_body, atol=1e-12)
    assert moved.off_goal(moved.body.T_world_body) == pytest.approx(0.8)
