"""Forward kinematics and Jacobian, against pinocchio."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin
import pytest

from planners.kinematics.forward import flange_pose, flange_pose_of_plan, frame_motion, jacobian, link_frames
from tests.kinematics.arm_oracle import ARMS, UR3E, PinocchioArm, published_urdf, random_pose


@pytest.mark.parametrize("dh", ARMS.values(), ids=ARMS.keys())
def test_flange_is_where_pinocchio_puts_it_on_any_base(dh):
    rng = np.random.default_rng(0)
    oracle = PinocchioArm(dh)
    for q in rng.uniform(-2 * math.pi, 2 * math.pi, (200, 6)):
        T_world_base = random_pose(rng)
        expected = T_world_base @ oracle.flange_pose(q)
        np.testing.assert_allclose(flange_pose(dh, T_world_base, q), expected, atol=1e-13)


def test_flange_is_where_the_published_urdf_puts_it():
    """The URDF's right angles are rounded to 2e-10 rad, which the arm's length keeps below 1e-9 m."""
    rng = np.random.default_rng(1)
    model = pin.buildModelFromXML(published_urdf("arms/ur3e/ur3e.urdf"))
    data = model.createData()
    base, tool = model.getFrameId("base"), model.getFrameId("tool0")
    for q in rng.uniform(-math.pi, math.pi, (200, 6)):
        pin.framesForwardKinematics(model, data, q)
        expected = data.oMf[base].actInv(data.oMf[tool]).homogeneous
        np.testing.assert_allclose(flange_pose(UR3E, np.eye(4), q), expected, atol=2e-9)


def test_nothing_is_compiled_for_arrays_that_must_not_be_written_to():
    """Arms are watched by such: those of a plan. Compiling takes seconds, in which they would not be."""
    q = np.arange(6.0)
    expected = flange_pose(UR3E, np.eye(4), q)
    compiled = set(flange_pose.signatures)
    sealed = [array.copy() for array in (UR3E, np.eye(4), q)]
    for array in sealed:
        array.setflags(write=False)
    np.testing.assert_array_equal(flange_pose_of_plan(*sealed), expected)
    assert set(flange_pose.signatures) == compiled


def test_each_frame_follows_from_the_one_before_by_its_row_of_the_table():
    rng = np.random.default_rng(2)
    q = rng.uniform(-math.pi, math.pi, 6)
    dh, T_world_base = ARMS["ur3e with joint offsets"], random_pose(rng)
    frames = np.empty((7, 4, 4))
    link_frames(dh, T_world_base, q, frames)
    np.testing.assert_array_equal(frames[0], T_world_base)
    for i, (a, alpha, d, theta0) in enumerate(dh):
        turn = pin.SE3(pin.utils.rotate("z", q[i] + theta0), np.zeros(3))
        step = turn * pin.SE3(pin.utils.rotate("x", alpha), np.array([a, 0.0, d]))
        np.testing.assert_allclose(frames[i + 1], frames[i] @ step.homogeneous, atol=1e-14)


@pytest.mark.parametrize("dh", ARMS.values(), ids=ARMS.keys())
def test_jacobian_of_any_point_of_the_flange_is_pinocchios(dh):
    rng = np.random.default_rng(3)
    oracle = PinocchioArm(dh)
    for q in rng.uniform(-math.pi, math.pi, (50, 6)):
        expected = oracle.jacobian(q)
        point = rng.uniform(-1.0, 1.0, 3)
        lever = point - oracle.flange_pose(q)[:3, 3]
        expected[:3] += np.cross(expected[3:].T, lever).T
        np.testing.assert_allclose(jacobian(dh, np.eye(4), q, point), expected, atol=1e-12)


def test_jacobian_on_a_turned_base_is_the_turned_jacobian():
    rng = np.random.default_rng(4)
    q, point, T = rng.uniform(-math.pi, math.pi, 6), rng.uniform(-1.0, 1.0, 3), random_pose(rng)
    in_base = jacobian(UR3E, np.eye(4), q, point)
    in_world = jacobian(UR3E, T, q, T[:3, :3] @ point + T[:3, 3])
    np.testing.assert_allclose(in_world, np.kron(np.eye(2), T[:3, :3]) @ in_base, atol=1e-12)


@pytest.mark.parametrize("dh", ARMS.values(), ids=ARMS.keys())
def test_a_frame_on_the_flange_moves_with_it_as_the_jacobian_says(dh):
    rng = np.random.default_rng(5)
    for q, velocities in zip(rng.uniform(-math.pi, math.pi, (20, 6)), rng.normal(size=(20, 6)), strict=True):
        T_world_base, T_flange_frame = random_pose(rng), random_pose(rng)
        T, twist = frame_motion(dh, T_world_base, T_flange_frame, q, velocities)
        np.testing.assert_allclose(T, flange_pose(dh, T_world_base, q) @ T_flange_frame, atol=1e-14)
        expected = jacobian(dh, T_world_base, q, T[:3, 3].copy()) @ velocities
        np.testing.assert_allclose(twist, expected, atol=1e-13)
