"""Least times between solutions of the inverse kinematics, by brute force over pairs and a fine sampling of the way."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from planners.regrasp.carried import CarriedPace
from planners.regrasp.travel import least_travel
from tests.kinematics.arm_oracle import PinocchioArm

COUNT, BRANCHES = 6, 4


@pytest.fixture
def solutions() -> tuple[np.ndarray, np.ndarray]:
    """Two sets of joint positions; many branches have none, and one grasp has none at all."""
    rng = np.random.default_rng(21)
    one, other = rng.uniform(-np.pi, np.pi, (2, COUNT, BRANCHES, 6))
    one[rng.random((COUNT, BRANCHES)) < 0.4] = np.nan
    other[rng.random((COUNT, BRANCHES)) < 0.4] = np.nan
    one[0, 0] = other[0, 0] = 0.1
    other[1] = np.nan
    return one, other


def shorter_way(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    return (end - start + np.pi) % (2.0 * np.pi) - np.pi


def brute_force(one: np.ndarray, other: np.ndarray, seconds) -> np.ndarray:
    pairs = [
        [seconds(k, a, shorter_way(a, b)) for a in one[k] for b in other[k] if np.isfinite([*a, *b]).all()]
        for k in range(len(one))
    ]
    return np.array([min(each, default=np.inf) for each in pairs])


def test_the_slowest_joint_of_the_nearest_pair_counts(cell, solutions):
    arm = cell.arms["left"]
    expected = brute_force(*solutions, lambda k, start, step: np.max(np.abs(step) / arm.velocity_max))
    assert least_travel(arm, *solutions) == pytest.approx(expected)
    assert expected[0] == 0.0
    assert np.isinf(expected[1])


def test_what_is_carried_takes_its_time(cell, solutions):
    arm, pace = cell.arms["left"], CarriedPace(speed=0.3, turn=1.0)
    chain, T_tool_flange = PinocchioArm(arm.dh), np.tile(np.eye(4), (COUNT, 1, 1))
    T_tool_flange[:, 2, 3] = 0.2

    def seconds(k: int, start: np.ndarray, step: np.ndarray) -> float:
        poses = np.array([chain.flange_pose(start + s * step) for s in np.linspace(0.0, 1.0, 200)])
        lips = poses @ np.linalg.inv(T_tool_flange[k])[:, 3]
        turns = Rotation.from_matrix(poses[1:, :3, :3] @ poses[:-1, :3, :3].transpose(0, 2, 1)).magnitude()
        way = np.linalg.norm(np.diff(lips[:, :3], axis=0), axis=1).sum()
        return max(np.max(np.abs(step) / arm.velocity_max), way / pace.speed, turns.sum() / pace.turn)

    expected = brute_force(*solutions, seconds)
    found = least_travel(arm, *solutions, T_tool_flange, pace)
    assert np.array_equal(np.isinf(found), np.isinf(expected))
    moving = np.isfinite(expected) & (expected > 0.0)
    # Few chords cut corners, so they are a little short.
    assert (found[moving] <= expected[moving] * (1.0 + 1e-9)).all()
    assert found[moving] == pytest.approx(expected[moving], rel=0.15)
