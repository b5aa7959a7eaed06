"""Two arms that come and go by turns, with pinocchio's kinematics and python-fcl's distances as the authorities."""

from __future__ import annotations

import numpy as np
import pytest

from planners.geometry.pose import inverse, transform
from planners.kinematics.inverse import follow_branch
from planners.regrasp.grasps.arm_sweeps import first_branches, sweep_arm
from tests.kinematics.arm_oracle import random_pose
from tests.regrasp.hand_oracle import NEAR, ToolCell

WAY = np.linspace(0.0, 0.070, 15)
WIDTH = 0.034


@pytest.fixture(scope="module")
def flanges() -> np.ndarray:
    """Flange poses all over the place where both arms reach: their arms often meet, their hands more often."""
    rng = np.random.default_rng(14)
    poses = np.array([random_pose(rng) for _ in range(60)])
    poses[:, :3, 3] = rng.uniform([0.25, -0.12, 1.30], [0.45, 0.12, 1.65], (60, 3))
    return poses


def without_hands(workcell):
    def chosen(a, b) -> bool:
        return workcell.between_arms(a, b) and not all(workcell.is_hand(body, body.group) for body in (a, b))

    return chosen


def back(cell, arm: str, T_world_flange: np.ndarray, branch: int) -> np.ndarray:
    poses = np.array([T_world_flange @ transform(None, [0, 0, -s]) for s in WAY])
    base = cell.arms[arm]
    return follow_branch(base.dh, inverse(base.T_world_base), poses, branch, np.empty((0, 6)))


@pytest.mark.slow
def test_arms_are_found_apart_exactly_when_fcl_finds_them_so_at_every_place(cell, long_workcell, flanges):
    widths = {"left": WIDTH, "right": WIDTH}
    query = long_workcell.query(widths, {"tool": None}, only=without_hands(long_workcell))
    probe, only = ToolCell(long_workcell), without_hands(long_workcell)
    rng, verdicts = np.random.default_rng(15), []
    for _ in range(3000):
        if len(verdicts) == 30:
            break
        one, two = rng.choice(len(flanges), 2, replace=False)
        branches = rng.integers(0, 8, 2)
        ways = [
            back(cell, arm, flanges[k], b) for arm, k, b in zip(("left", "right"), (one, two), branches, strict=True)
        ]
        if not np.isfinite(np.concatenate(ways)).all():
            continue
        sweeps = []
        for arm, k, branch in zip(("left", "right"), (one, two), branches, strict=True):
            base = cell.arms[arm]
            chosen = np.array([1 << branch], np.uint8)
            sweeps.append(
                sweep_arm(base.dh, base.T_world_base, inverse(base.T_world_base), flanges[k][None].copy(), chosen, WAY)
            )
        codes = np.zeros((1, 1), np.uint8)
        first_branches(query.kernel, np.zeros((1, 2), np.int64), *sweeps, codes)
        assert codes[0, 0] in (0, 1 + 8 * branches[0] + branches[1])
        moments = [(q, ways[1][0]) for q in ways[0]] + [(ways[0][0], q) for q in ways[1]]
        slack = 1.0
        for pair in moments:
            slack = min(slack, probe.least_slack(np.concatenate(pair), np.eye(4), widths, only))
            if slack < 0.0:
                break
        if abs(slack) > NEAR:
            verdicts.append(slack > 0.0)
            assert bool(codes[0, 0]) == (slack > 0.0)
    assert sum(verdicts) > 5
    assert len(verdicts) - sum(verdicts) > 5
