"""Joints that bear what a hand carries: postures, edges, timed motion, and whole plans of an arm with weak wrists."""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import replace
from itertools import count
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from scipy.spatial.transform import Rotation

from planners.cell.arm import Arm
from planners.certify.common.joint_torque import torque_check
from planners.contract.task_spec import SuctionToolTask, read_task
from planners.geometry.pose import Array, inverse, transform
from planners.graph.rejections import Rejection
from planners.kinematics.forward import flange_poses
from planners.kinematics.inverse import inverse_kinematics
from planners.motion.trajectory import Trajectory
from planners.planning import plan
from planners.progress import silent
from planners.regrasp.grasps.handovers import HandoverDatabase
from planners.regrasp.grasps.tool_grasps import ToolGrasps
from planners.regrasp.statics.laden_arm import LadenArm, LadenChecker, bearing_branches
from planners.regrasp.statics.static_hold import CarriedLoad, CarryingHand, StaticHold
from planners.regrasp.tool_segment import SuckedObject
from planners.scene.scene import build_scene
from planners.scene.tool_scene import SuctionToolScene
from tests.kinematics.arm_oracle import PinocchioArm
from tests.support.documents import evidence_of
from tests.support.tool_plans import FEW, block, few_handovers

TASK = Path(__file__).parents[2] / "assets" / "tasks" / "tissue_pile.json"
T_TOOL_OBJECT = transform(Rotation.from_euler("z", 0.4).as_matrix(), [0.012, -0.02, -0.03])
T_FLANGE_TOOL = transform(Rotation.from_euler("xyz", [1.2, 0.4, -0.3]).as_matrix(), [0.02, 0.05, 0.21])
MOST_TORQUE = 0.4
"""Of each joint's largest [1]."""
LEAST_COSINE = 0.6
"""Of the tool's tilt [1]."""


@pytest.fixture(scope="module")
def scene() -> SuctionToolScene:
    task = read_task(json.loads(TASK.read_text()))
    assert isinstance(task, SuctionToolTask)
    return build_scene(task)


@pytest.fixture(scope="module")
def load(scene: SuctionToolScene) -> CarriedLoad:
    return StaticHold(scene, 0.0).load(SuckedObject(scene.objects[0].name, T_TOOL_OBJECT))


@pytest.fixture(scope="module")
def arm(scene: SuctionToolScene) -> Arm:
    return scene.cell.arms["left"]


@pytest.fixture(scope="module")
def laden(arm: Arm, load: CarriedLoad) -> LadenArm:
    return LadenArm.of(arm, load.gravity, T_FLANGE_TOOL, load)


class Oracle:
    """Pinocchio's arm with its links, its hand, and tool and object as further bodies on the flange."""

    def __init__(self, arm: Arm, load: CarriedLoad, T_flange_tool: Array) -> None:
        self.model = PinocchioArm(arm.dh).model
        self.model.gravity.linear = arm.T_world_base[:3, :3].T @ load.gravity
        rows = [(mass, np.array(com)) for mass, *com in arm.masses]
        for mass, centre in zip(load.masses, load.centres, strict=True):
            rows.append((mass, T_flange_tool[:3, :3] @ centre + T_flange_tool[:3, 3]))
        for number, (mass, com) in enumerate(rows):
            joint = min(number, 5)
            a, alpha, d, _ = arm.dh[joint]
            frame = pin.SE3(pin.utils.rotate("x", alpha), np.array([a, 0.0, d]))
            self.model.appendBodyToJoint(joint + 1, pin.Inertia(mass, com, np.zeros((3, 3))), frame)
        self.data = self.model.createData()

    def torques(self, q: Array, v: Array | None = None, a: Array | None = None) -> Array:
        return pin.rnea(self.model, self.data, q, np.zeros(6) if v is None else v, np.zeros(6) if a is None else a)


def swing(scale: float) -> Trajectory:
    """All joints of both arms to and fro."""
    time = np.linspace(0.0, 1.0, 60)
    rate = np.array([1.0, 1.3, 2.0, 1.7, 2.3, 1.1, *np.ones(6)])
    start = np.array([0.3, -1.2, 1.4, -0.6, 0.8, 0.2, *np.zeros(6)])
    phase = time[:, None] * rate
    parts = np.sin(phase), rate * np.cos(phase), -(rate**2) * np.sin(phase)
    q, v, a = (scale * part for part in parts)
    return Trajectory(time, start + q, v, a, time)


def test_the_share_of_a_posture_is_pinocchios_with_tool_and_object_on_the_flange(arm, load, laden):
    oracle, rng = Oracle(arm, load, T_FLANGE_TOOL), np.random.default_rng(0)
    for q in rng.uniform(-np.pi, np.pi, (200, 6)):
        expected = np.max(np.abs(oracle.torques(q)) / arm.torque_max)
        assert laden.share(q) == pytest.approx(expected, abs=1e-12)


def test_a_branch_is_kept_where_pinocchio_finds_all_its_torques_within_what_may_be_used(
    arm: Arm, load: CarriedLoad, long_grasps: ToolGrasps
) -> None:
    T_tool_flange = long_grasps.T_tool_flange(arm.hand)  # type: ignore[arg-type]
    rng, verdicts = np.random.default_rng(1), []
    heavy = load._replace(masses=load.masses + np.array([0.0, 1.0]))
    for angle in rng.uniform(-np.pi, np.pi, 3):
        T_world_tool = transform(Rotation.from_euler("xz", [0.3, angle]).as_matrix(), [0.35, 0.3, 1.25])
        reached = np.zeros(len(T_tool_flange), np.uint8)
        solutions = np.empty((len(T_tool_flange), 8, 6))
        for grasp, T in enumerate(T_tool_flange):
            reached[grasp] = inverse_kinematics(
                arm.dh, inverse(arm.T_world_base) @ T_world_tool @ T, 0.0, solutions[grasp]
            )
        kept = bearing_branches(arm, T_world_tool, T_tool_flange, heavy, reached, 0.45)
        for grasp in np.flatnonzero(reached)[::40]:
            oracle = Oracle(arm, heavy, inverse(T_tool_flange[grasp]))
            for branch in range(8):
                if reached[grasp] >> branch & 1:
                    used = np.max(np.abs(oracle.torques(solutions[grasp, branch])) / arm.torque_max)
                    verdicts.append(bool(kept[grasp] >> branch & 1))
                    assert verdicts[-1] == (used <= 0.55)
                else:
                    assert not kept[grasp] >> branch & 1
    assert 10 < sum(verdicts) < len(verdicts) - 10


class Anywhere:
    """An edge checker that finds nothing in the way."""

    def state_free(self, q: Array) -> bool:
        return True

    edge_free = path_free = lambda self, *_: True


def test_an_edge_is_free_just_where_all_its_places_are_borne_and_level(arm, load, laden, long_grasps):
    # With half the squeeze the fingers do not bear the load in every level pose.
    weak = load._replace(fingers=load.fingers * np.array([0.5, 1.0, 1.0, 1.0]))
    hand = CarryingHand(arm, T_FLANGE_TOOL, long_grasps.T_tool_tcp[0], float(long_grasps.widths[0]), weak)
    checker = LadenChecker(Anywhere(), hand, LEAST_COSINE, laden, MOST_TORQUE)
    rng, answers = np.random.default_rng(2), Counter()
    for q in rng.uniform(-np.pi, np.pi, (2000, 6)):
        other = q + rng.uniform(-0.4, 0.4, 6)
        steps = 1 + int(np.ceil(np.abs(other - q).max() / 0.05))
        places = q + np.linspace(0.0, 1.0, steps + 1)[:, None] * (other - q)
        level = (flange_poses(arm.dh, arm.T_world_base, places) @ T_FLANGE_TOOL)[:, 2, 2] >= LEAST_COSINE
        held = np.array([hand.bears(place, place, 0.05, -1.0) for place in places])
        strong = np.array([laden.share(place) <= MOST_TORQUE for place in places])
        free = level & held & strong
        assert checker.edge_free(q, other) == checker.path_free(places) == free.all()
        assert checker.state_free(q) == free[0]
        answers[bool(level.all()), bool(held.all()), bool(strong.all())] += 1
    # Each of the three alone decides somewhere.
    for needed in ((True, True, True), (False, True, True), (True, False, True), (True, True, False)):
        assert answers[needed]


def peak(oracle: Oracle, timed: Trajectory, slowness: float, arm: Arm) -> float:
    """The greatest part of any joint's largest torque along a motion made so much slower."""
    rows = zip(timed.positions[:, :6], timed.velocities[:, :6], timed.accelerations[:, :6], strict=True)
    torques = [oracle.torques(q, v / slowness, a / slowness**2) for q, v, a in rows]
    return float(np.max(np.abs(torques) / arm.torque_max))


def test_a_motion_is_stretched_until_its_joints_bear_it_and_no_further(arm, load, laden):
    oracle, timed = Oracle(arm, load, T_FLANGE_TOOL), swing(1.0)
    at_rest, moving = peak(oracle, timed, 1e6, arm), peak(oracle, timed, 1.0, arm)
    assert laden.stretch(timed, slice(0, 6), 1.0 - 1.01 * moving, "transfer") == 1.0
    between = 0.5 * (at_rest + moving)
    stretch = laden.stretch(timed, slice(0, 6), 1.0 - between, "transfer")
    assert isinstance(stretch, float)
    assert stretch > 1.0
    assert peak(oracle, timed, stretch, arm) == pytest.approx(between)


@pytest.mark.parametrize("seed", range(10))
def test_however_a_motion_is_stretched_no_joint_gives_more_than_it_may_and_what_is_refused_is_borne_by_none(
    arm, load, laden, seed: int
) -> None:
    """Motions at random, also those in which what moves a load takes some of it off joints that do not bear it."""
    rng, oracle = np.random.default_rng(seed), Oracle(arm, load, T_FLANGE_TOOL)
    for _ in range(20):
        scales = np.array([1.5, rng.uniform(0.0, 3.0), rng.uniform(0.0, 15.0)])
        rows = scales[:, None, None] * rng.normal(size=(3, 4, 12))
        timed = Trajectory(np.arange(4.0), *rows, np.arange(4.0))
        most = float(rng.uniform(0.1, 1.0)) * peak(oracle, timed, 1.0, arm)
        stretch = laden.stretch(timed, slice(0, 6), 1.0 - most, "transfer")
        if isinstance(stretch, float):
            assert peak(oracle, timed, stretch, arm) <= most * (1.0 + 1e-9)
        else:
            assert max(peak(oracle, timed, slowness, arm) for slowness in (32.0, 1e6)) >= most * (1.0 - 1e-9)


def test_a_motion_that_joints_do_not_bear_however_slow_is_refused_with_the_joint_and_its_torque(arm, load, laden):
    oracle, timed = Oracle(arm, load, T_FLANGE_TOOL), swing(1.0)
    shares = np.abs([oracle.torques(q) for q in timed.positions[:, :6]]) / arm.torque_max
    sample, joint = np.unravel_index(int(shares.argmax()), shares.shape)
    refusal = laden.stretch(timed, slice(0, 6), 1.0 - 0.9 * shares.max(), "transfer")
    assert isinstance(refusal, Rejection)
    assert refusal.unit == "Nm"
    assert refusal.needed == pytest.approx(shares.max() * arm.torque_max[joint])
    assert refusal.available == pytest.approx(0.9 * refusal.needed)
    assert arm.joint_names[joint] in refusal.reason
    assert refusal.where == f"{arm.joint_names[joint]}, {timed.time[sample]:.3f} s into a transfer"


@pytest.fixture(scope="module")
def handovers(scene: SuctionToolScene) -> HandoverDatabase:
    return few_handovers(scene.cell, scene.tool, FEW)


def with_wrists(torque: float, outcome: str, handovers: HandoverDatabase):
    """Plan a block's move with arms whose wrists give so much [Nm]; return the document and the certificate's check."""
    task = read_task({"kind": "suction_tool", "objects": [block(mass=0.8)]})
    scene = build_scene(task)
    arms = {}
    for name, one in scene.cell.arms.items():
        weak = np.concatenate([one.torque_max[:3], np.full(3, torque)])
        arms[name] = replace(one, robot=replace(one.robot, torque_max=weak))
    scene = replace(scene, cell=replace(scene.cell, arms=arms))
    ticks = count()
    document = plan(task, scene, silent, lambda: float(next(ticks)), lambda *_: handovers).document()
    assert document["outcome"] == outcome
    return document, torque_check(evidence_of(document))


@pytest.mark.slow
def test_where_one_plan_asks_too_much_of_a_joint_another_is_found(handovers):
    """Wrists are made so weak that the plan of strong ones is none."""
    _, strong = with_wrists(9.0, "solved", handovers)
    used = 0.95 * 9.0 - strong.margin
    _, weak = with_wrists(2.2, "solved", handovers)
    assert used > 2.2
    assert weak.passed


@pytest.mark.slow
def test_wrists_that_bear_too_little_are_named_as_the_reason(handovers):
    document, _ = with_wrists(1.9, "not_found", handovers)
    rejected = document["statistics"]["rejections"]
    assert any(reason.startswith("torque: left_wrist_1_joint would need") for reason in rejected)
    cause = document["explanation"]["causes"][0]
    assert "wrist_1_joint would need more torque" in cause["reason"]
    assert cause["needed"] > cause["available"]
    assert cause["unit"] == "Nm"
