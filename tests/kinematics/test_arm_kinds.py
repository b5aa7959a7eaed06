"""Arms of both kinds: those that are shipped, every sign that a table can have, and eaik as another authority."""

from __future__ import annotations

import itertools
import math
from functools import cache

import numpy as np
import pytest
from eaik.pybindings import EAIK
from scipy.optimize import least_squares

from planners.cell.arm import load_robot
from planners.cell.asset_shelf import shipped_shelf
from planners.kinematics.arm_kind import ArmKind, NoClosedForm, arm_kind
from planners.kinematics.forward import flange_pose
from planners.kinematics.inverse import BRANCHES, inverse_kinematics, manipulability
from planners.kinematics.windings import wrap
from tests.kinematics.arm_oracle import ARMS, INDUSTRIAL, PUMA, UR3E, PinocchioArm
from tests.support.samples import sample

ROBOTS = shipped_shelf().names("robots")
RIGHT, STRAIGHT = (90.0, -90.0), (0.0, 180.0)
KINDS = {
    ArmKind.PARALLEL_AXES: (RIGHT, STRAIGHT, STRAIGHT, RIGHT, RIGHT),
    ArmKind.SPHERICAL_WRIST: (RIGHT, STRAIGHT, RIGHT, RIGHT, RIGHT),
}


@cache
def table_of(name: str) -> np.ndarray:
    return ARMS[name] if name in ARMS else load_robot(name, shipped_shelf()).dh


def all_branches(dh: np.ndarray, poses: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return which branches are valid (n, 8), and all of them (n, 8, 6)."""
    found, valid = np.empty((len(poses), BRANCHES, 6)), np.empty((len(poses), BRANCHES), bool)
    for k, T in enumerate(poses):
        mask = inverse_kinematics(dh, T, 0.0, found[k])
        valid[k] = [bool(mask >> branch & 1) for branch in range(BRANCHES)]
    np.testing.assert_array_equal(valid, ~np.isnan(found).any(axis=2))
    return valid, found


def turns_apart(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the largest difference of joint vectors along the last axis, up to whole turns."""
    return np.abs(np.angle(np.exp(1j * (a - b)))).max(axis=-1)


def assert_solved(dh: np.ndarray, Q: np.ndarray) -> None:
    """Check that all branches put the flange where pinocchio has it, and that the arm is in one of them."""
    oracle = PinocchioArm(dh)
    poses = oracle.flange_poses(Q)
    valid, found = all_branches(dh, poses)
    reached = oracle.flange_poses(found[valid])
    np.testing.assert_allclose(reached, np.repeat(poses, valid.sum(axis=1), axis=0), atol=2e-9)
    apart = np.where(valid, turns_apart(found, Q[:, None]), np.inf)
    assert apart.min(axis=1).max() < 1e-6


@pytest.mark.parametrize("robot", ROBOTS)
def test_ten_thousand_random_poses_of_a_shipped_arm_are_reproduced_by_all_branches(robot):
    rng = np.random.default_rng(0)
    assert_solved(table_of(robot), rng.uniform(-math.pi, math.pi, (10_000, 6)))


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.name)
def test_an_arm_whose_axes_point_any_way_is_solved(kind):
    rng = np.random.default_rng(1)
    for alphas in itertools.product(*KINDS[kind]):
        dh = np.zeros((6, 4))
        dh[:5, 1], dh[5, 1] = np.radians(alphas), rng.uniform(-math.pi, math.pi)
        dh[:, 0] = rng.uniform(0.1, 0.5, 6) * rng.choice([-1.0, 1.0], 6)
        dh[:, 2], dh[:, 3] = rng.uniform(-0.3, 0.3, 6), rng.uniform(-math.pi, math.pi, 6)
        if kind is ArmKind.PARALLEL_AXES:
            dh[[0, 3, 4], 0] = 0.0
        else:
            dh[3:5, 0], dh[4, 2] = 0.0, 0.0
        assert arm_kind(dh) is kind
        assert_solved(dh, rng.uniform(-math.pi, math.pi, (20, 6)))


def of_eaik(dh: np.ndarray, T: np.ndarray) -> np.ndarray:
    """Return all exact solutions (k, 6) of eaik in our joint positions, each once."""
    solver = EAIK.Robot(dh[:, 1], dh[:, 0], dh[:, 2], np.eye(3), [], True)
    assert solver.has_known_decomposition()
    answer = solver.calculate_IK(T)
    exact = [q - dh[:, 3] for q, rounded in zip(answer.Q, answer.is_LS, strict=True) if not rounded]
    return np.array(exact).reshape(-1, 6)


@pytest.mark.parametrize("name", [*ROBOTS, "ur3e with joint offsets", "industrial", "puma"])
def test_the_branches_are_those_that_eaik_finds(name):
    """Which solves the same equations by geometric subproblems (Ostermeier and others, 2024).

    Not asked about parallel axes that point opposite ways: what eaik 1.2.2 then calls exact is far from the pose, also
    by its own forward kinematics.
    """
    rng = np.random.default_rng(2)
    dh = table_of(name)
    oracle = PinocchioArm(dh)
    for q in rng.uniform(-math.pi, math.pi, (sample(40, 1000), 6)):
        T = oracle.flange_pose(q)
        theirs = of_eaik(dh, T)
        ((valid,), (found,)) = all_branches(dh, T[None])
        ours = found[valid]
        apart = turns_apart(ours[:, None], theirs[None])
        assert apart.min(axis=1).max() < 1e-5, "a branch that eaik does not have"
        assert apart.min(axis=0).max() < 1e-5, "a solution of eaik's that is no branch"


@pytest.mark.parametrize("name", ["ur3e", "industrial", "puma"])
@pytest.mark.slow
def test_a_search_from_many_starts_finds_the_same_branches_and_no_other(name):
    rng = np.random.default_rng(3)
    dh = table_of(name)
    for q in rng.uniform(-math.pi, math.pi, (2, 6)):
        T = flange_pose(dh, np.eye(4), q)

        def residual(q: np.ndarray, T: np.ndarray = T) -> np.ndarray:
            return (flange_pose(dh, np.eye(4), q) - T)[:3].ravel()

        ((valid,), (found,)) = all_branches(dh, T[None])
        starts = rng.uniform(-math.pi, math.pi, (120, 6))
        ends = [least_squares(residual, start, xtol=1e-14, ftol=1e-14, gtol=1e-14, max_nfev=60) for start in starts]
        searched = np.array([end.x for end in ends if np.abs(end.fun).max() < 1e-9])
        apart = turns_apart(found[valid][:, None], searched[None])
        assert apart.min(axis=0).max() < 1e-6
        assert apart.min(axis=1).max() < 1e-6


@pytest.mark.parametrize("name", ARMS)
def test_the_manipulability_is_the_determinant_of_the_jacobian(name):
    rng = np.random.default_rng(11)
    dh = table_of(name)
    oracle = PinocchioArm(dh)
    for q in rng.uniform(-np.pi, np.pi, (50, 6)):
        determinant = abs(np.linalg.det(oracle.jacobian(q)))
        assert manipulability(dh, q) == pytest.approx(determinant, rel=1e-9, abs=1e-12)


def test_the_bits_of_a_branch_with_a_spherical_wrist_are_the_signs_of_its_roots():
    """The wrist ahead of the first axis or behind it, joint 5 to one side or the other, the elbow up or down."""
    rng = np.random.default_rng(6)
    oracle = PinocchioArm(INDUSTRIAL)
    for q in rng.uniform(-math.pi, math.pi, (100, 6)):
        T = oracle.flange_pose(q)
        wrist = T[:3, 3] - 0.085 * T[:3, 2]
        ((valid,), (found,)) = all_branches(INDUSTRIAL, T[None])
        straight = -math.atan2(0.795, 0.115)
        for branch in np.flatnonzero(valid):
            ahead = wrist[0] * math.cos(found[branch, 0]) + wrist[1] * math.sin(found[branch, 0])
            assert (ahead < 0.0) == bool(branch & 4)
            assert (found[branch, 4] < 0.0) == bool(branch & 2)
            assert (wrap(found[branch, 2] - straight) < 0.0) == bool(branch & 1)


def test_a_spherical_wrist_on_the_first_axis_leaves_that_joint_free_and_is_reproduced():
    rng = np.random.default_rng(7)
    oracle = PinocchioArm(INDUSTRIAL)
    T = np.eye(4)
    for _ in range(50):
        T[:3, :3] = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        T[:3, 0] *= np.linalg.det(T[:3, :3])
        T[:3, 3] = [0.0, 0.0, 1.1] + 0.085 * T[:3, 2]
        ((valid,), (found,)) = all_branches(INDUSTRIAL, T[None])
        assert valid.any()
        np.testing.assert_allclose(oracle.flange_poses(found[valid]), np.tile(T, (valid.sum(), 1, 1)), atol=1e-9)


def test_a_spherical_wrist_out_of_reach_has_no_solution():
    far, beside = np.eye(4), np.eye(4)
    far[0, 3] = 3.0
    # The arm of this one passes by its first axis at 0.22 m: nothing nearer is reached.
    beside[2, 3] = 0.5
    assert not all_branches(INDUSTRIAL, far[None])[0].any()
    assert not all_branches(PUMA, beside[None])[0].any()


FAULTS = {
    "parallel axes aslant": (UR3E, 1, 1, 0.1, "alpha 2 is 5.7"),
    "a fourth axis aslant": (UR3E, 2, 1, 0.1, "alpha 3 is 5.7"),
    "a wrist aslant": (UR3E, 4, 1, 0.1, "alpha 5 is -84.2"),
    "a shoulder beside its axis": (UR3E, 0, 0, 0.1, "a 1 is 0.1 m, not 0"),
    "a wrist beside its axis": (UR3E, 3, 0, 0.1, "a 4 is 0.1 m, not 0"),
    "no upper arm": (UR3E, 1, 0, -UR3E[1, 0], "a 2 is 0, so that axes 2 and 3 are one"),
    "a wrist whose axes do not meet": (INDUSTRIAL, 4, 2, 0.1, "d 5 is 0.1 m, not 0"),
    "a spherical wrist beside its axis": (INDUSTRIAL, 4, 0, 0.1, "a 5 is 0.1 m, not 0"),
    "a forearm aslant": (INDUSTRIAL, 1, 1, 0.1, "alpha 2 is 5.7"),
    "no lower arm": (INDUSTRIAL, 1, 0, -INDUSTRIAL[1, 0], "a 2 is 0"),
}


@pytest.mark.parametrize("case", FAULTS.values(), ids=FAULTS.keys())
def test_an_arm_of_neither_kind_is_told_why(case):
    dh, row, column, more, reason = case
    other = dh.copy()
    other[row, column] += more
    assert isinstance(arm_kind(dh), ArmKind)
    kind = arm_kind(other)
    assert isinstance(kind, NoClosedForm)
    assert reason in kind.reason


@pytest.mark.parametrize("robot", ROBOTS)
def test_forward_kinematics_of_a_shipped_arm_are_pinocchios(robot):
    rng = np.random.default_rng(8)
    dh = table_of(robot)
    oracle = PinocchioArm(dh)
    for q in rng.uniform(-2 * math.pi, 2 * math.pi, (50, 6)):
        np.testing.assert_allclose(flange_pose(dh, np.eye(4), q), oracle.flange_pose(q), atol=1e-13)
