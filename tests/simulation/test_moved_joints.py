"""What a hand is told to do, against the kinematics of its arm."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from planners.contract.task_spec import read_task
from planners.geometry.pose import rotation_from_vector
from planners.kinematics.forward import flange_pose
from planners.scene.lift_scene import PlateLiftScene
from planners.scene.scene import build_scene
from workers.simulation.hands import moved_joints

TASKS = Path(__file__).resolve().parents[2] / "assets" / "tasks"
POSTURE = np.array([0.4, -1.2, 1.4, -1.0, -1.3, 0.5])


@pytest.fixture(scope="module")
def scene() -> PlateLiftScene:
    return build_scene(read_task(json.loads((TASKS / "pb1.json").read_text())))


@pytest.mark.parametrize("seed", range(5))
def test_a_hand_that_gives_way_is_put_exactly_there(scene, seed: int) -> None:
    """Pads that bear a torque are turned by a tenth of a radian: to first order a hand would be millimetres off."""
    rng = np.random.default_rng(seed)
    arm = scene.cell.arms[scene.cell.gripper_arms[0]]
    T_flange_hand = arm.hand.T_flange_tcp(scene.plate.height)
    away = np.concatenate([rng.uniform(-0.005, 0.005, 3), rng.uniform(-0.1, 0.1, 3)])
    T = flange_pose(arm.dh, arm.T_world_base, POSTURE) @ T_flange_hand
    moved = flange_pose(arm.dh, arm.T_world_base, moved_joints(arm, T_flange_hand, POSTURE, away)) @ T_flange_hand
    assert moved[:3, 3] == pytest.approx(T[:3, 3] + away[:3], abs=2e-5)
    assert moved[:3, :3] == pytest.approx(rotation_from_vector(away[3:]) @ T[:3, :3], abs=2e-4)
