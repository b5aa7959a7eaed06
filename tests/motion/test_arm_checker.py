"""The edge checker of one arm asks the collision query about both, the other arm at rest."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray

from planners.collision.model import CollisionModel, CollisionQuery
from planners.geometry.convex import CollisionBody, ConvexShape
from planners.kinematics.forward import flange_pose
from planners.motion.checker import ArmEdgeChecker
from planners.motion.path_search import plan_motion
from planners.motion.query import MotionOutcome, MotionQuery, MotionSettings

Array = NDArray[np.float64]

UR3E_DH = np.array(
    [
        [0.0, np.pi / 2, 0.15185, 0.0],
        [-0.24355, 0.0, 0.0, 0.0],
        [-0.2132, 0.0, 0.0, 0.0],
        [0.0, np.pi / 2, 0.13105, 0.0],
        [0.0, -np.pi / 2, 0.08535, 0.0],
        [0.0, 0.0, 0.0921, 0.0],
    ]
)
BASES = {"left": np.eye(4), "right": np.eye(4)}
BASES["right"][:3, 3] = [0.0, -0.4, 0.0]
HAND = 0.08
OBSTACLE = np.array([0.35, -0.2, 0.3])
OBSTACLE_RADIUS = 0.15
Q_REST = np.radians([10.0, -60.0, 40.0, -70.0, -90.0, 0.0, 10.0, -60.0, 40.0, -70.0, -90.0, 0.0])
SLICES = {"left": slice(0, 6), "right": slice(6, 12)}


@pytest.fixture(scope="module")
def query() -> CollisionQuery:
    """A ball at either flange, and one that stands still."""
    ball = ConvexShape(np.zeros((1, 3)), HAND)
    bodies = [CollisionBody(f"{arm}_hand", arm, f"{arm}/6", (ball,)) for arm in BASES]
    bodies.append(CollisionBody("obstacle", "cell", "world", (ConvexShape(OBSTACLE[None], OBSTACLE_RADIUS),)))
    return CollisionModel.build({arm: (UR3E_DH, T) for arm, T in BASES.items()}, bodies, set()).scene({})


def hands(q12: Array) -> dict[str, Array]:
    return {arm: flange_pose(UR3E_DH, BASES[arm], q12[joints])[:3, 3] for arm, joints in SLICES.items()}


def free(q12: Array) -> bool:
    """Balls apart, by their centres."""
    at = hands(q12)
    apart = float(np.linalg.norm(at["left"] - at["right"])) > 2.0 * HAND
    return apart and all(float(np.linalg.norm(p - OBSTACLE)) > HAND + OBSTACLE_RADIUS for p in at.values())


@pytest.mark.parametrize("arm", ["left", "right"])
def test_states_are_judged_with_the_other_arm_at_rest(query: CollisionQuery, arm: str) -> None:
    checker = ArmEdgeChecker(query, Q_REST, SLICES[arm])
    verdicts = []
    for q in np.random.default_rng(0).uniform(-np.pi, np.pi, (600, 6)):
        q12 = Q_REST.copy()
        q12[SLICES[arm]] = q
        verdicts.append(free(q12))
        assert checker.state_free(q) == verdicts[-1]
    assert len(set(verdicts)) == 2


@pytest.mark.parametrize("arm", ["left", "right"])
def test_a_planned_motion_is_free_at_every_point(query: CollisionQuery, arm: str) -> None:
    checker = ArmEdgeChecker(query, Q_REST, SLICES[arm])
    rng = np.random.default_rng(1)
    limit = np.full(6, 2.0 * np.pi)
    checked = 0
    for _ in range(30):
        ends = rng.uniform(-np.pi, np.pi, (2, 6))
        result = plan_motion(MotionQuery(ends[0], ends[1:], -limit, limit, checker), MotionSettings(), rng)
        if result.path is None:
            assert result.outcome in (MotionOutcome.START_IN_COLLISION, MotionOutcome.GOALS_IN_COLLISION)
            continue
        assert checker.path_free(result.path)
        for a, b in pairwise(result.path):
            for t in np.linspace(0.0, 1.0, 100):
                q12 = Q_REST.copy()
                q12[SLICES[arm]] = a + t * (b - a)
                assert free(q12)
                checked += 1
    assert checked > 1000


def test_both_arms_can_move_at_once(query: CollisionQuery) -> None:
    checker = ArmEdgeChecker(query, np.full(12, np.nan), slice(0, 12))
    assert checker.state_free(Q_REST) == free(Q_REST)
    assert checker.edge_free(Q_REST, Q_REST) == free(Q_REST)
