"""Directions that are told are those of the documented frame: x leads away from the robot, y to its left."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from planners import read_task
from planners.contract.task_change import PatchOperation
from planners.contract.task_spec import PlateLiftTask, SuctionToolTask
from planners.geometry.pose import from_pose7
from planners.manipulation.lift_settings import LiftSettings
from planners.progress import silent
from planners.remedies.change import Effort, TaskChange
from planners.remedies.directions import straight_ways, straightest, told_move, told_way
from planners.remedies.lift_changes import LiftChanges
from planners.remedies.tool_changes import ToolChanges
from planners.scene.scene import build_scene
from tests.support.plan_shelf import PlanShelf

TASKS = Path(__file__).resolve().parents[2] / "assets" / "tasks"
POST = {"name": "post", "shape": {"type": "box", "size": [0.02, 0.02, 0.1]}, "pose": [0.65, 0.35, 1.144, 1, 0, 0, 0]}
UNITS = {
    "away from the robot": (1.0, 0.0),
    "towards the robot": (-1.0, 0.0),
    "to the left": (0.0, 1.0),
    "to the right": (0.0, -1.0),
}


def posted(name: str, **members: Any) -> Any:
    return read_task(json.loads((TASKS / f"{name}.json").read_bytes()) | members)


def way_in(sentence: str) -> np.ndarray:
    """Return the way (2,) that a sentence tells [m, world]."""
    told = re.findall(rf"(\d+) mm ({'|'.join(UNITS)})", sentence)
    assert told, sentence
    return sum((1e-3 * int(length) * np.array(UNITS[words]) for length, words in told), np.zeros(2))


def place_in(sentence: str) -> np.ndarray:
    """Return the place (2,) in the world that a sentence tells [m]."""
    told = re.search(r"to x = (-?\d+), y = (-?\d+) mm", sentence)
    assert told is not None, sentence
    return 1e-3 * np.array([int(value) for value in told.groups()])


def place_of(step: PatchOperation) -> np.ndarray:
    """Return the place (2,) in the world to which a step of a patch puts something [m]."""
    pose: Any = step.value["pose"] if isinstance(step.value, dict) else step.value
    return np.array(pose[:2])


@pytest.mark.parametrize(
    ("way", "told"),
    [
        ([0.05, 0.0], "50 mm away from the robot"),
        ([-0.05, 0.0], "50 mm towards the robot"),
        ([0.0, 0.02], "20 mm to the left"),
        ([0.03, -0.04], "30 mm away from the robot and 40 mm to the right"),
        ([0.0, 0.0001], ""),
    ],
)
def test_ways_are_told_as_seen_from_behind_the_robot(way: list[float], told: str) -> None:
    assert told_way(np.array(way)) == told


def test_a_move_is_told_with_where_it_leads() -> None:
    assert told_move(np.array([-0.075, 0.0]), [0.4, -0.1, 1.1]) == "75 mm towards the robot, to x = 325, y = -100 mm"


@pytest.mark.parametrize("number", range(4))
def test_the_straightest_way_is_the_one_that_leads_most_there(number: int) -> None:
    way = straight_ways()[number]
    assert straightest(0.3 * way + 0.2 * way[::-1]) == pytest.approx(way)


@pytest.fixture(scope="module")
def turned() -> LiftChanges:
    """Return the changes of a lift to one side of the robot, of a plate that is turned, with an obstacle beside it."""
    pose = [0.4, 0.25, 1.114, 0.9659258, 0, 0, 0.258819]
    task = posted(
        "ab1", plate_pose=pose, cup={"position": [0.1, 0], "radius": 0.0175, "max_force": 20}, obstacles=[POST]
    )
    assert isinstance(task, PlateLiftTask)
    changes = LiftChanges(task, build_scene, LiftSettings(), Effort(100), silent)
    changes._leaves_a_way = lambda *_, **__: True  # type: ignore[method-assign]
    return changes


def moves(changes: list[TaskChange]) -> list[TaskChange]:
    return [change for change in changes if change.sentence.startswith("Move ")]


def test_a_plate_and_obstacles_are_moved_along_the_axes_of_the_world_to_where_is_told(turned: LiftChanges) -> None:
    places, obstacles = moves([*turned._plate_place()]), moves([*turned._obstacles()])
    assert len(places) > 7
    assert obstacles
    for change, start in [*((each, (0.4, 0.25)) for each in places), *((each, (0.65, 0.35)) for each in obstacles)]:
        there = place_of(change.patch[0])
        assert way_in(change.sentence) == pytest.approx(there - start, abs=1e-3)
        assert place_in(change.sentence) == pytest.approx(there, abs=1e-3)
    straight = [place_of(change.patch[0]) - (0.4, 0.25) for change in places][:4]
    assert all(np.count_nonzero(np.abs(way) > 1e-9) == 1 for way in straight)


def test_the_cup_is_moved_on_a_turned_plate_as_the_world_sees_it(turned: LiftChanges) -> None:
    T_world_plate = from_pose7(turned.task.plate_pose)
    turned.__dict__["_cut"] = []
    changes = [*turned._cup_places()]
    assert changes
    for change in changes:
        shift = np.array(change.patch[0].value) - (0.1, 0.0)  # type: ignore[operator]
        assert way_in(change.sentence) == pytest.approx(T_world_plate[:2, :2] @ shift, abs=1e-3)


def test_the_cup_of_a_plate_that_is_not_turned_moves_as_far_as_its_place_says() -> None:
    task = posted(
        "ab1", plate_pose=[0.4, 0.25, 1.114, 1, 0, 0, 0], cup={"position": [0.1, 0], "radius": 0.0175, "max_force": 20}
    )
    changes = LiftChanges(task, build_scene, LiftSettings(), Effort(0), silent)
    told = changes._cup_at((0.025, 0.0)).sentence
    assert told == "Move the cup 75 mm towards the robot, to (25, 0) mm on the plate."


def test_objects_and_goals_are_moved_along_the_axes_of_the_world_to_where_is_told(shelf: PlanShelf) -> None:
    task = posted("lid_under_roof", obstacles=[])
    assert isinstance(task, SuctionToolTask)
    failed = shelf.plan(posted("lid_too_heavy", options={"remedies": False}))
    changes = ToolChanges(task, build_scene, failed, lambda _: False)
    (each,) = task.objects
    for start, told in ((each.pose, moves([*changes._starts()])), (each.goal_pose, moves([*changes._goals()]))):
        assert told
        for change in told:
            there = place_of(change.patch[0])
            assert way_in(change.sentence) == pytest.approx(there - np.array(start[:2]), abs=1e-3)
            assert place_in(change.sentence) == pytest.approx(there, abs=1e-3)
