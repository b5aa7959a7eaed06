"""What is remembered of the reach of other lifts is what would be found anew."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from planners.contract.task_spec import PlateLiftTask, read_task
from planners.graph.rejections import Rejections
from planners.manipulation.lift_reach import LiftReach
from planners.manipulation.lift_sampling import LiftSampling
from planners.manipulation.reach.reach_memory import ReachMemory
from planners.planning import lift_settings
from planners.progress import silent
from planners.scene.lift_scene import PlateLiftScene
from planners.scene.scene import build_scene
from tests.support.samples import among

AB1 = json.loads((Path(__file__).parents[2] / "assets" / "tasks" / "ab1.json").read_text())
WALL = {"name": "wall", "shape": {"type": "box", "size": [0.02, 0.5, 0.3]}, "pose": [0.55, 0, 1.25, 1, 0, 0, 0]}
CHANGES: dict[str, dict[str, Any]] = {
    "as it is": {},
    "the cup beside the rim": {"cup": AB1["cup"] | {"position": [-0.13, 0.1]}},
    "the cup in the middle": {"cup": AB1["cup"] | {"position": [0.0, 0.0]}},
    "a larger cup": {"cup": AB1["cup"] | {"radius": 0.04}},
    "a stronger cup": {"cup": AB1["cup"] | {"max_force": 30}},
    "a cable": {"lifter_model": "cable"},
    "turned": {"plate_pose": [0.3, 0, 1.114, 0.9238795, 0, 0, 0.3826834]},
    "thinner": {
        "plate": AB1["plate"] | {"shape": {"type": "box", "size": [0.3, 0.3, 0.03]}},
        "plate_pose": [0.3, 0, 1.109, 1, 0, 0, 0],
    },
    "beside a wall": {"obstacles": [WALL]},
    "fewer holds": {"options": {"hold_density": 0.5}},
}


def sampling(change: dict[str, Any]) -> LiftSampling:
    task = read_task(AB1 | change)
    assert isinstance(task, PlateLiftTask)
    scene = build_scene(task)
    assert isinstance(scene, PlateLiftScene)
    return LiftSampling.of(scene, lift_settings(task.options))


def reached(asked: LiftSampling, memory: ReachMemory | None) -> tuple[np.ndarray, np.ndarray]:
    return LiftReach(asked, Rejections(), silent, memory).reached.sets


@pytest.fixture(scope="module")
def memory() -> ReachMemory:
    """Has seen every lift once, the last one first."""
    memory = ReachMemory()
    for change in reversed(CHANGES.values()):
        reached(sampling(change), memory)
    return memory


@pytest.mark.parametrize("what", among(CHANGES, ["as it is", "the cup in the middle", "turned", "thinner"]))
def test_what_is_remembered_is_what_would_be_found(what: str, memory: ReachMemory) -> None:
    asked = sampling(CHANGES[what])
    for known, fresh in zip(reached(asked, memory), reached(asked, None), strict=True):
        assert np.array_equal(known, fresh)


@pytest.mark.slow
def test_the_cup_takes_postures_away_somewhere() -> None:
    """Otherwise its place could be forgotten, and nothing here would tell."""
    middle, rim = (sampling(CHANGES[f"the cup {where}"]) for where in ("in the middle", "beside the rim"))
    assert not np.array_equal(reached(middle, None)[1], reached(rim, None)[1])
