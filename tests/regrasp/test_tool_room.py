"""Whether there is room for the tool at a suction pose."""

from __future__ import annotations

import numpy as np
import pytest

from planners.geometry.pose import inverse, rotation_y, transform
from planners.graph.rejections import Rejections
from planners.regrasp.grasps.tool_grasps import ToolGrasps
from planners.regrasp.motion.scene_state import SceneState
from planners.regrasp.motion.state_queries import StateQueries
from planners.regrasp.motion.tool_room import ToolRoom
from planners.regrasp.suction.suction_poses import SuctionPose
from planners.regrasp.tool_workcell import ToolWorkcell
from planners.scene.tool_scene import SuctionToolScene
from tests.regrasp.tool_tasks import TABLE, box, pose, scene_of

DESCENT = 0.05
PLATE = 0.0225
"""Half of the widest part of the tool, the marker plate [m]."""


def asked(scene: SuctionToolScene, grasps: ToolGrasps, *poses: SuctionPose, most: int = 99) -> tuple[int, Rejections]:
    """Return how many of the poses have room, and why the others have none."""
    state = SceneState(
        q=scene.start_positions,
        widths=scene.start_widths,
        holder=None,
        T_world_tool=scene.tool.T_world_tool,
        T_world_objects={each.name: each.body.T_world_body for each in scene.objects},
        sucked=None,
        segments=(),
    )
    rejections = Rejections()
    room = ToolRoom(StateQueries(ToolWorkcell.of(scene), grasps), DESCENT)
    return len(room.poses(state, scene.objects[0], poses, most, rejections)), rejections


def sideways(height: float) -> SuctionPose:
    """A level tool on the side of a box whose middle is 0.15 above the table, at a height above the table."""
    T_object_tool = transform(rotation_y(0.5 * np.pi), [0.05, 0.0, height - 0.15])
    return SuctionPose(T_object_tool, 0, 0, True, 1.0)


UPRIGHT = SuctionPose(transform(None, [0.0, 0.0, 0.15]), 0, 0, True, 1.0)
TALL = box("tall", [0.35, 0.28], [0.4, -0.25], (0.1, 0.1, 0.3))


@pytest.mark.parametrize(("height", "fits"), [(PLATE - 0.002, False), (PLATE + 0.005, True)])
def test_a_level_tool_has_room_over_the_table_where_its_plate_has(
    long_grasps: ToolGrasps, height: float, fits: bool
) -> None:
    count, rejections = asked(scene_of(TALL), long_grasps, sideways(height))
    assert count == fits
    assert any("room beside table" in reason for reason in rejections.counts()) is not fits


def test_there_is_no_room_under_a_roof_at_the_start_nor_at_the_goal(long_grasps: ToolGrasps) -> None:
    for place, end in (([0.35, 0.28], "start"), ([0.4, -0.25], "goal")):
        roof = {
            "name": "roof",
            "shape": {"type": "box", "size": [0.2, 0.2, 0.02]},
            "pose": pose([*place, 0, 0.4], 0.01),
        }
        count, rejections = asked(scene_of(TALL, obstacles=[roof]), long_grasps, UPRIGHT)
        assert count == 0
        assert any(f"at its {end}, the tool has no room beside roof" in reason for reason in rejections.counts())


def test_no_more_poses_are_asked_than_are_wanted(long_grasps: ToolGrasps) -> None:
    assert asked(scene_of(TALL), long_grasps, UPRIGHT, UPRIGHT, UPRIGHT, most=2)[0] == 2


def test_the_height_of_the_cup_is_what_the_test_means(long_grasps: ToolGrasps) -> None:
    (tall,) = scene_of(TALL).objects
    T_world_tool = tall.body.T_world_body @ sideways(0.1).T_object_tool
    assert T_world_tool[2, 3] == pytest.approx(TABLE + 0.1)
    assert inverse(T_world_tool)[0, 2] == pytest.approx(-1.0)
