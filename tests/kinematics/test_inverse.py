"""All branches of the closed-form inverse, against pinocchio's forward kinematics."""

from __future__ import annotations

import math

import numpy as np
import pytest

from planners.kinematics.inverse import BRANCHES, inverse_kinematics
from planners.kinematics.parallel_axes import WRIST_SINGULAR
from tests.kinematics.arm_oracle import ARMS, INDUSTRIAL, PUMA, UR3E, PinocchioArm


def solve(dh: np.ndarray, T_base_flange: np.ndarray, q6_free: float = 0.0) -> dict[int, np.ndarray]:
    """Return the valid branches, and check what is promised of every answer."""
    out = np.zeros((BRANCHES, 6))
    mask = inverse_kinematics(dh, np.ascontiguousarray(T_base_flange), q6_free, out)
    valid = [branch for branch in range(BRANCHES) if mask >> branch & 1]
    invalid = [branch for branch in range(BRANCHES) if branch not in valid]
    assert np.isnan(out[invalid]).all()
    assert (out[valid] > -math.pi).all()
    assert (out[valid] <= math.pi).all()
    return {branch: out[branch] for branch in valid}


def turns_apart(q: np.ndarray, other: np.ndarray) -> float:
    """Return the largest difference of two joint vectors, up to whole turns."""
    return float(np.abs(np.angle(np.exp(1j * (q - other)))).max())


def assert_reproduced(oracle: PinocchioArm, T_base_flange: np.ndarray, branches: dict[int, np.ndarray]) -> None:
    for q in branches.values():
        np.testing.assert_allclose(oracle.flange_pose(q), T_base_flange, atol=1e-9)


@pytest.mark.parametrize("dh", ARMS.values(), ids=ARMS.keys())
def test_random_poses_are_reproduced_by_all_branches_and_the_arm_is_one_of_them(dh):
    rng = np.random.default_rng(0)
    oracle = PinocchioArm(dh)
    for q in rng.uniform(-math.pi, math.pi, (500, 6)):
        T_base_flange = oracle.flange_pose(q)
        branches = solve(dh, T_base_flange)
        assert_reproduced(oracle, T_base_flange, branches)
        assert min(turns_apart(q, found) for found in branches.values()) < 1e-7


@pytest.mark.parametrize("dh", [UR3E, INDUSTRIAL, PUMA], ids=["ur3e", "industrial", "puma"])
@pytest.mark.parametrize("q5", [0.0, math.pi, -math.pi, 0.5 * WRIST_SINGULAR, -0.5 * WRIST_SINGULAR])
def test_a_singular_wrist_takes_the_free_joint_as_told(dh, q5):
    rng = np.random.default_rng(1)
    oracle = PinocchioArm(dh)
    for q in rng.uniform(-math.pi, math.pi, (100, 6)):
        q[4] = q5 - dh[4, 3]
        T_base_flange = oracle.flange_pose(q)
        for q6_free in (q[5], 0.4):
            branches = solve(dh, T_base_flange, q6_free)
            parallel = [found for found in branches.values() if abs(math.sin(found[4] + dh[4, 3])) < WRIST_SINGULAR]
            for found in parallel:
                assert found[5] == pytest.approx(q6_free, abs=1e-12)
                np.testing.assert_allclose(oracle.flange_pose(found), T_base_flange, atol=abs(math.sin(q5)) + 1e-9)
            # With another position of joint 6 the pose may be out of the elbow's reach; with its own it is not.
            if q6_free == q[5]:
                assert parallel
                assert min(turns_apart(q, found) for found in branches.values()) < WRIST_SINGULAR + 1e-7


def straight(dh: np.ndarray) -> float:
    """Return the position of joint 3 at which the point that the elbow reaches for is farthest away."""
    if abs(math.sin(dh[2, 1])) < 0.5:
        return -dh[2, 3]
    along = math.cos(dh[1, 1])
    return -along * math.atan2(-along * math.sin(dh[2, 1]) * dh[3, 2], dh[2, 0]) - dh[2, 3]


@pytest.mark.parametrize("dh", [UR3E, INDUSTRIAL, PUMA], ids=["ur3e", "industrial", "puma"])
@pytest.mark.parametrize("q3", [0.0, math.pi, -math.pi])
def test_a_straight_or_folded_elbow_is_one_solution_of_two_equal_branches(dh, q3):
    rng = np.random.default_rng(2)
    oracle = PinocchioArm(dh)
    for q in rng.uniform(-math.pi, math.pi, (100, 6)):
        q[2] = q3 + straight(dh)
        T_base_flange = oracle.flange_pose(q)
        branches = solve(dh, T_base_flange)
        assert_reproduced(oracle, T_base_flange, branches)
        # At the end of its range the arc cosine turns an error of 1e-16 into one of 1e-8, and a folded arm is 7 times
        # shorter than its links, which turns that into 1e-7 for the joints beside it.
        equal = [branch for branch, found in branches.items() if turns_apart(q, found) < 1e-5]
        assert len(equal) == 2
        assert equal[1] == equal[0] + 1


def shoulder_singular(q: np.ndarray) -> np.ndarray:
    """Turn joint 2 until the wrist point is as near to the axis of joint 1 as it can be."""
    dh = UR3E
    planar = dh[1, 0] + dh[2, 0] * np.exp(1j * q[2]) - 1j * dh[4, 2] * np.exp(1j * (q[2] + q[3]))
    singular = q.copy()
    singular[1] = math.pi / 2 - np.angle(planar)
    return singular


def test_a_wrist_above_the_shoulder_is_reproduced_and_its_shoulder_branches_meet():
    rng = np.random.default_rng(3)
    oracle = PinocchioArm(UR3E)
    for random in rng.uniform(-math.pi, math.pi, (300, 6)):
        q = shoulder_singular(random)
        T_base_flange = oracle.flange_pose(q)
        branches = solve(UR3E, T_base_flange)
        assert_reproduced(oracle, T_base_flange, branches)
        found = [branch for branch, other in branches.items() if turns_apart(q, other) < 1e-5]
        assert {branch // 4 for branch in found} == {0, 1}


def test_all_singularities_at_once_are_reproduced():
    oracle = PinocchioArm(UR3E)
    q = shoulder_singular(np.array([0.7, 0.0, 0.0, 0.3, 0.0, -1.1]))
    T_base_flange = oracle.flange_pose(q)
    branches = solve(UR3E, T_base_flange, q6_free=q[5])
    assert_reproduced(oracle, T_base_flange, branches)
    assert min(turns_apart(q, found) for found in branches.values()) < 1e-5


def test_the_edge_of_reach_counts_as_inside_up_to_rounding_and_a_millimetre_beyond_is_outside():
    rng = np.random.default_rng(4)
    oracle = PinocchioArm(UR3E)
    for q in rng.uniform(-math.pi, math.pi, (200, 6)):
        q[2] = 0.0
        T_base_flange = oracle.flange_pose(q)
        along = np.array([math.cos(q[0]) * math.cos(q[1]), math.sin(q[0]) * math.cos(q[1]), math.sin(q[1])])
        outward = math.copysign(1.0, UR3E[1, 0]) * along
        straight = next(k for k, found in solve(UR3E, T_base_flange).items() if turns_apart(q, found) < 1e-6)
        for distance, expected in ((1e-11, True), (1e-3, False)):
            moved = T_base_flange.copy()
            moved[:3, 3] += distance * outward
            branches = solve(UR3E, moved)
            assert (straight in branches) == expected
            assert_reproduced(oracle, moved, branches)


def test_a_pose_out_of_reach_or_on_the_axis_of_the_shoulder_has_no_solution():
    far = np.eye(4)
    far[:3, 3] = [2.0, 0.0, 0.0]
    on_axis = np.eye(4)
    assert solve(UR3E, far) == {}
    assert solve(UR3E, on_axis) == {}


@pytest.mark.parametrize("dh", ARMS.values(), ids=ARMS.keys())
def test_every_branch_moves_as_its_own_jacobian_says(dh):
    """So a branch keeps its meaning along a motion: it never jumps to another one."""
    rng = np.random.default_rng(5)
    oracle = PinocchioArm(dh)
    compared = 0
    for q in rng.uniform(-math.pi, math.pi, (500, 6)):
        step = 1e-6 * rng.normal(size=6)
        twist = oracle.jacobian(q) @ step
        before, after = solve(dh, oracle.flange_pose(q)), solve(dh, oracle.flange_pose(q + step))
        for branch, found in before.items():
            J = oracle.jacobian(found)
            if np.linalg.cond(J) > 1e3:
                continue
            compared += 1
            expected = np.linalg.solve(J, twist)
            assert turns_apart(after[branch], found + expected) < 1e-2 * np.linalg.norm(expected) + 1e-9
    assert compared > 1000


def test_the_bits_of_a_branch_are_the_signs_of_wrist_and_elbow():
    rng = np.random.default_rng(6)
    oracle = PinocchioArm(UR3E)
    for q in rng.uniform(-math.pi, math.pi, (100, 6)):
        for branch, found in solve(UR3E, oracle.flange_pose(q)).items():
            assert (found[4] < 0.0) == bool(branch & 2)
            assert (found[2] < 0.0) == bool(branch & 1)
