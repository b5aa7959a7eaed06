"""Postures that are drawn with the tool about upright, by the forward kinematics of pinocchio."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from planners.cell.arm import Arm
from planners.cell.cell import load_cell
from planners.geometry.pose import Array, inverse, transform
from planners.kinematics.inverse import inverse_kinematics
from planners.regrasp.motion.upright_postures import UprightPostures, UprightPostureSettings
from tests.kinematics.arm_oracle import PinocchioArm

T_FLANGE_TOOL = transform(Rotation.from_euler("xyz", [1.6, 0.1, -0.3]).as_matrix(), [0.02, 0.05, 0.21])
LEAST_COSINE = np.cos(np.radians(40.0))
SETTINGS = UprightPostureSettings()
ARMS = [("dual_ur3e_tool", "left"), ("dual_ur3e_tool", "right"), ("dual_ur5e_tool", "right")]


def tools(arm: Arm, Q: Array) -> Array:
    """Return T_world_tool (n, 4, 4)."""
    return arm.T_world_base @ PinocchioArm(arm.dh).flange_poses(Q) @ T_FLANGE_TOOL


def upright(arm: Arm, rng: np.random.Generator) -> Array:
    """Return postures (n, 6) with the tool upright, turned any way about the vertical."""
    found, solutions = [], np.empty((8, 6))
    while len(found) < 12:
        shoulder = arm.T_world_base[:3, 3]
        position = shoulder + rng.uniform(-0.7, 0.7, 3) * arm.robot.reach
        yaw = Rotation.from_rotvec([0.0, 0.0, rng.uniform(-np.pi, np.pi)]).as_matrix()
        pose = inverse(arm.T_world_base) @ transform(yaw, position) @ inverse(T_FLANGE_TOOL)
        inverse_kinematics(arm.dh, np.ascontiguousarray(pose), 0.0, solutions)
        found += [q.copy() for q in solutions if np.isfinite(q).all()]
    return np.array(found)


@pytest.mark.parametrize(("cell", "name"), ARMS)
@pytest.mark.parametrize("seed", range(4))
def test_between_upright_ends_all_are_upright_within_range_and_about_the_straight_way(
    cell: str, name: str, seed: int
) -> None:
    arm, rng = load_cell(cell).arms[name], np.random.default_rng(seed)
    ends = upright(arm, rng)
    start, goals = ends[0], ends[1:4]
    source = UprightPostures(arm, T_FLANGE_TOOL, LEAST_COSINE)
    drawn = source.drawn(start, goals, rng)
    assert len(drawn) > 0
    assert np.all((arm.position_min <= drawn) & (drawn <= arm.position_max))
    found = tools(arm, drawn)
    np.testing.assert_allclose(found[:, 2, 2], 1.0, atol=1e-9)
    assert source.fits(drawn).all()
    first, last = tools(arm, start[None])[0, :3, 3], tools(arm, goals)[:, :3, 3]
    beyond = SETTINGS.aside * arm.robot.reach * np.array([1.0, 1.0, 1.0])
    low, high = np.minimum(first, last) - beyond * [1, 1, 0], np.maximum(first, last) + beyond
    inside = (low - 1e-9 <= found[:, None, :3, 3]) & (found[:, None, :3, 3] <= high + 1e-9)
    assert inside.all(axis=2).any(axis=1).all()


@pytest.mark.parametrize(("cell", "name"), ARMS)
def test_a_posture_fits_as_long_as_the_tool_is_no_more_tilted_than_asked(cell: str, name: str) -> None:
    arm, rng = load_cell(cell).arms[name], np.random.default_rng(1)
    Q = rng.uniform(-np.pi, np.pi, (400, 6))
    expected = tools(arm, Q)[:, 2, 2] >= LEAST_COSINE
    assert 10 < np.count_nonzero(expected) < 390
    assert UprightPostures(arm, T_FLANGE_TOOL, LEAST_COSINE).fits(Q).tolist() == expected.tolist()


def test_the_same_seed_draws_the_same() -> None:
    arm = load_cell("dual_ur3e_tool").arms["left"]
    ends = upright(arm, np.random.default_rng(2))
    source = UprightPostures(arm, T_FLANGE_TOOL, LEAST_COSINE)
    first, second = (source.drawn(ends[0], ends[1:], np.random.default_rng(3)) for _ in range(2))
    assert np.array_equal(first, second)
