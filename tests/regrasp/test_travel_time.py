"""Least times between solutions of the inverse kinematics, by brute force over pairs and a fine sampling of the way."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from planners.cell.arm import Arm
from planners.cell.cell import Cell
from planners.regrasp.motion.travel_time import EFFORT, least_travel_time, straight_times
from planners.regrasp.tool_settings import CarriedPace
from tests.kinematics.arm_oracle import PinocchioArm

COUNT, BRANCHES = 6, 4
PACE = CarriedPace(speed=0.3, turn=1.0)
T_TOOL_FLANGE = np.eye(4)
T_TOOL_FLANGE[2, 3] = 0.2


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


def shortest_way(start: np.ndarray, end: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """The shortest turn of each joint that ends within limits; the shortest of all where none does."""
    turns = end - start + 2.0 * np.pi * np.arange(-2, 3)[:, None]
    within = (start + turns >= low) & (start + turns <= high)
    kept = np.where(within | ~within.any(axis=0), np.abs(turns), np.inf)
    return turns[kept.argmin(axis=0), np.arange(6)]


def brute_force(arm: Arm, one: np.ndarray, other: np.ndarray, carried: Callable) -> np.ndarray:
    """What joints and what is carried take, and of each joint the part that is counted for the effort."""

    def seconds(k: int, start: np.ndarray, end: np.ndarray) -> float:
        step = shortest_way(start, end, arm.position_min, arm.position_max)
        joints = np.abs(step) / arm.velocity_max
        return max(joints.max(), carried(k, start, step)) + EFFORT * joints.sum()

    pairs = [
        [seconds(k, a, b) for a in one[k] for b in other[k] if np.isfinite([*a, *b]).all()] for k in range(len(one))
    ]
    return np.array([min(each, default=np.inf) for each in pairs])


def nothing(k: int, start: np.ndarray, step: np.ndarray) -> float:
    return 0.0


@pytest.fixture
def carried(cell: Cell) -> Callable:
    """The time of a lip 0.2 m before the flange, at `PACE`, by forward kinematics at 200 places of the way."""
    chain = PinocchioArm(cell.arms["left"].dh)

    def seconds(k: int, start: np.ndarray, step: np.ndarray) -> float:
        poses = np.array([chain.flange_pose(start + s * step) for s in np.linspace(0.0, 1.0, 200)])
        lips = poses @ np.linalg.inv(T_TOOL_FLANGE)[:, 3]
        turns = Rotation.from_matrix(poses[1:, :3, :3] @ poses[:-1, :3, :3].transpose(0, 2, 1)).magnitude()
        way = np.linalg.norm(np.diff(lips[:, :3], axis=0), axis=1).sum()
        return max(way / PACE.speed, turns.sum() / PACE.turn)

    return seconds


def test_the_slowest_joint_of_the_nearest_pair_counts(cell, solutions):
    arm = cell.arms["left"]
    expected = brute_force(arm, *solutions, nothing)
    assert least_travel_time(arm, *solutions) == pytest.approx(expected)
    assert expected[0] == 0.0
    assert np.isinf(expected[1])


def test_a_joint_turns_the_long_way_round_where_its_limits_ask_for_it(cell):
    arm = cell.arms["left"]
    elbow = 2
    one, other = np.zeros((2, 1, 1, 6))
    one[..., elbow], other[..., elbow] = -3.0, 3.0
    turn = 6.0 / arm.velocity_max[elbow]
    assert arm.position_max[elbow] < 2.0 * np.pi - 3.0
    assert least_travel_time(arm, one, other)[0] == pytest.approx(turn * (1.0 + EFFORT))


def test_what_is_carried_takes_its_time(cell, solutions, carried):
    arm = cell.arms["left"]
    expected = brute_force(arm, *solutions, carried)
    found = least_travel_time(arm, *solutions, np.tile(T_TOOL_FLANGE, (COUNT, 1, 1)), PACE)
    assert np.array_equal(np.isinf(found), np.isinf(expected))
    moving = np.isfinite(expected) & (expected > 0.0)
    # Few chords cut corners, so they are a little short.
    assert (found[moving] <= expected[moving] * (1.0 + 1e-9)).all()
    assert found[moving] == pytest.approx(expected[moving], rel=0.15)


def test_going_on_is_added_before_the_least_is_taken(cell, solutions):
    arm = cell.arms["left"]
    one, other = solutions
    beyond = np.random.default_rng(3).uniform(0.0, 3.0, other.shape[:2])
    apart = [
        least_travel_time(arm, one, np.ascontiguousarray(other[:, b : b + 1])) + beyond[:, b] for b in range(BRANCHES)
    ]
    assert least_travel_time(arm, one, other, beyond=beyond) == pytest.approx(np.min(apart, axis=0))


def test_straight_times_are_those_of_single_goals_whatever_turns_they_are_in(cell, carried):
    arm, rng = cell.arms["left"], np.random.default_rng(5)
    start, goals = rng.uniform(-np.pi, np.pi, 6), rng.uniform(-2.0 * np.pi, 2.0 * np.pi, (COUNT, 6))
    joints = np.abs(goals - start) / arm.velocity_max
    effort = EFFORT * joints.sum(axis=1)
    assert straight_times(arm, start, goals) == pytest.approx(joints.max(axis=1) + effort)
    laden = [max(each.max(), carried(0, start, goal - start)) for each, goal in zip(joints, goals, strict=True)]
    found = straight_times(arm, start, goals, T_TOOL_FLANGE, PACE)
    assert found == pytest.approx(np.array(laden) + effort, rel=0.15)
