"""Joint torques, against pinocchio's recursion and its generalised gravity."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin
import pytest

from planners.cell.arm import load_robot
from planners.cell.asset_shelf import shipped_shelf
from planners.cell.cell import load_cell
from planners.kinematics.joint_torque import WeighedArm, joint_torques
from tests.kinematics.arm_oracle import published_urdf

GRAVITY = np.array([0.0, 0.0, -9.81])
CASES = [(robot, arm, hand) for robot in ("ur3e", "ur3") for arm, hand in (("left", "stick"), ("right", "gripper"))]
PUBLISHED = {
    "shoulder_link": (1.98, [0.0, 0.0, -0.02]),
    "upper_arm_link": (3.4445, [-0.11355, 0.0, 0.1157]),
    "forearm_link": (1.437, [-0.1632, 0.0, 0.0238]),
    "wrist_1_link": (0.871, [0.0, -0.01, 0.0]),
    "wrist_2_link": (0.805, [0.0, 0.01, 0.0]),
    "wrist_3_link": (0.261, [0.0, 0.0, -0.02]),
}
"""Of the UR3e, in the frames of its URDF; Universal_Robots_ROS2_Description, config/ur3e/physical_parameters.yaml."""


class ArmOracle:
    """A mounted arm with its hand in pinocchio, its links put together joint by joint."""

    def __init__(self, robot: str, arm: str) -> None:
        mounted = load_cell("dual_ur3e_lift").arms[arm]
        made = load_robot(robot, shipped_shelf())
        self.dh, self.T_world_base = made.dh, mounted.T_world_base
        self.masses = np.vstack([made.masses, mounted.masses[6:]])
        self.weighed = WeighedArm(self.dh, self.T_world_base, self.masses, GRAVITY)
        self.model = pin.Model()
        self.model.gravity.linear = GRAVITY
        parent, placement = 0, pin.SE3(self.T_world_base)
        for i, (a, alpha, d, theta0) in enumerate(self.dh):
            turn = pin.SE3(pin.utils.rotate("z", theta0), np.zeros(3))
            parent = self.model.addJoint(parent, pin.JointModelRZ(), placement * turn, f"joint_{i + 1}")
            placement = pin.SE3(pin.utils.rotate("x", alpha), np.array([a, 0.0, d]))
            for mass, *com in self.masses[i : i + 1] if i < 5 else self.masses[i:]:
                self.model.appendBodyToJoint(parent, pin.Inertia(mass, np.array(com), np.zeros((3, 3))), placement)
        self.flange = self.model.addFrame(pin.Frame("flange", parent, 0, placement, pin.FrameType.OP_FRAME))
        self.data = self.model.createData()

    def exerting(self, q: np.ndarray, wrench: np.ndarray, point: np.ndarray) -> np.ndarray:
        """Return J^T of a wrench about a point of the world."""
        pin.forwardKinematics(self.model, self.data, q)
        lever = point - pin.updateFramePlacement(self.model, self.data, self.flange).translation
        J = pin.computeFrameJacobian(self.model, self.data, q, self.flange, pin.LOCAL_WORLD_ALIGNED)
        return J.T @ np.concatenate([wrench[:3], wrench[3:] + np.cross(lever, wrench[:3])])


@pytest.fixture(scope="module", params=CASES, ids=["-".join(case) for case in CASES])
def arm(request) -> ArmOracle:
    return ArmOracle(*request.param[:2])


def random_states(count: int):
    rng = np.random.default_rng(0)
    wrenches = rng.normal(size=(count, 6)) * [20.0, 20.0, 20.0, 2.0, 2.0, 2.0]
    points = rng.uniform(-1.0, 1.0, (count, 3)) + np.array([0.4, 0.0, 1.2])
    return rng.uniform(-2.0 * math.pi, 2.0 * math.pi, (count, 6)), wrenches, points


def test_torques_at_rest_are_pinocchios_gravity_and_the_wrench_by_virtual_work(arm):
    Q, wrenches, points = random_states(1000)
    still = np.zeros_like(Q)
    torques = joint_torques(arm.weighed, Q, still, still, wrenches, points)
    for q, wrench, point, ours in zip(Q, wrenches, points, torques, strict=True):
        exerting = arm.exerting(q, wrench, point)
        held = pin.computeGeneralizedGravity(arm.model, arm.data, q) + exerting
        np.testing.assert_allclose(ours, held, atol=1e-11)
        recursion = pin.rnea(arm.model, arm.data, q, np.zeros(6), np.zeros(6)) + exerting
        np.testing.assert_allclose(ours, recursion, atol=1e-11)


def test_torques_of_a_motion_are_pinocchios(arm):
    Q, wrenches, points = random_states(300)
    rng = np.random.default_rng(1)
    V, A = rng.uniform(-6.0, 6.0, (2, 300, 6))
    torques = joint_torques(arm.weighed, Q, V, A, wrenches, points)
    for q, v, a, wrench, point, ours in zip(Q, V, A, wrenches, points, torques, strict=True):
        expected = pin.rnea(arm.model, arm.data, q, v, a) + arm.exerting(q, wrench, point)
        np.testing.assert_allclose(ours, expected, atol=1e-10)


def test_the_ur3es_links_weigh_where_the_published_description_says():
    """Other frames, other figures, and the kinematics of the URDF: the same torques against gravity.

    The lengths of the URDF are the table's, and its right angles are rounded to 2e-10 rad.
    """
    arm = ArmOracle("ur3e", "left")
    model = pin.buildModelFromXML(published_urdf("arms/ur3e/ur3e.urdf"))
    for joint in range(1, model.njoints):
        model.inertias[joint] = pin.Inertia.Zero()
    for name, (mass, com) in PUBLISHED.items():
        frame = model.frames[model.getFrameId(name)]
        inertia = pin.Inertia(mass, np.array(com), np.zeros((3, 3)))
        model.appendBodyToJoint(frame.parentJoint, inertia, frame.placement)
    data = model.createData()
    pin.framesForwardKinematics(model, data, np.zeros(6))
    base = data.oMf[model.getFrameId("base")].homogeneous
    without_hand = np.vstack([arm.masses[:6], np.zeros(4)])
    bare = WeighedArm(arm.dh, base, without_hand, GRAVITY)
    rng = np.random.default_rng(2)
    still = np.zeros((1, 6))
    for q in rng.uniform(-math.pi, math.pi, (100, 6)):
        ours = joint_torques(bare, q[None], still, still, still, np.zeros((1, 3)))[0]
        np.testing.assert_allclose(ours, pin.computeGeneralizedGravity(model, data, q), atol=1e-6)


@pytest.mark.slow
def test_a_hand_that_bears_more_weight_pulls_at_the_joints_as_a_heavier_hand_does():
    """The sign of the wrench: what is exerted upward on a body weighs on the hand."""
    arm = ArmOracle("ur3e", "right")
    Q = random_states(50)[0]
    still, none = np.zeros_like(Q), np.zeros((50, 6))
    heavier = arm.weighed._replace(masses=arm.masses + 1.5 * np.eye(7, 4, -6))
    with_mass = joint_torques(heavier, Q, still, still, none, none[:, :3])
    centres = np.empty((50, 3))
    for k, q in enumerate(Q):
        pin.forwardKinematics(arm.model, arm.data, q)
        centres[k] = pin.updateFramePlacement(arm.model, arm.data, arm.flange).act(arm.masses[6, 1:])
    up = np.tile([0.0, 0.0, 1.5 * 9.81, 0.0, 0.0, 0.0], (50, 1))
    exerting = joint_torques(arm.weighed, Q, still, still, up, centres)
    np.testing.assert_allclose(exerting, with_mass, atol=1e-11)
