"""The motion of a whole lift: joined, held, timed, in balance and free, by pinocchio's and fcl's word."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from planners import read_task, solve
from planners.cell.cell import load_cell
from planners.geometry.pose import rotation_angle
from planners.graph.rejections import Rejection
from planners.hands.arm_motion import FreeMotion, FreeMove, Stuck
from planners.motion.blended_path import BlendedPath
from planners.motion.checker import EdgeChecker
from planners.plan.segment import SegmentKind
from tests.kinematics.arm_oracle import PinocchioArm
from tests.manipulation.lift_probe import task_body

STILL = [kind for kind in SegmentKind if kind is not SegmentKind.TRANSFER]


@pytest.fixture(scope="module")
def segments(solved):
    return solved.segments


@pytest.fixture(scope="module")
def flange(planner):
    """T_world_flange of an arm at twelve joint positions."""
    arms = planner.scene.cell.arms
    chains = {name: PinocchioArm(arm.dh) for name, arm in arms.items()}
    return lambda arm, q: arms[arm].T_world_base @ chains[arm].flange_pose(q[planner.sampling.workcell.joints(arm)])


def test_it_begins_with_the_plate_and_the_arms_where_the_task_says(planner, segments):
    assert segments[0].trajectory.positions[0] == pytest.approx(planner.scene.start_positions)
    assert segments[0].T_world_body[0] == pytest.approx(planner.scene.T_world_plate)


def test_each_segment_starts_where_the_last_ended(segments):
    for before, after in pairwise(segments):
        assert after.trajectory.positions[0] == pytest.approx(before.trajectory.positions[-1], abs=1e-9)
        assert after.T_world_body[0] == pytest.approx(before.T_world_body[-1], abs=1e-9)
        for arm, width in after.widths.items():
            assert width[0] == pytest.approx(before.widths[arm][-1], abs=1e-12)


def test_every_segment_begins_and_ends_at_rest(segments):
    for segment in segments:
        assert segment.trajectory.velocities[[0, -1]] == pytest.approx(0.0, abs=1e-9)


def test_time_rises_in_steps_of_at_most_20_ms_and_rates_keep_within_the_arms_limits(planner, segments):
    arms = planner.scene.cell.arms.values()
    velocity = np.concatenate([arm.velocity_max for arm in arms])
    acceleration = np.concatenate([arm.acceleration_max for arm in arms])
    position = np.concatenate([arm.position_min for arm in arms]), np.concatenate([arm.position_max for arm in arms])
    for segment in segments:
        law = segment.trajectory
        assert law.time[0] == 0.0
        assert np.all(np.diff(law.time) > 0.0)
        assert np.diff(law.time).max() <= 0.020 + 1e-12
        assert np.all(np.abs(law.velocities) <= 1.001 * velocity)
        assert np.all(np.abs(law.accelerations) <= 1.001 * acceleration)
        assert np.all((law.positions >= position[0]) & (law.positions <= position[1]))
        steps = np.diff(law.positions, axis=0) / np.diff(law.time)[:, None]
        means = 0.5 * (law.velocities[1:] + law.velocities[:-1])
        assert np.abs(steps - means).max() <= 0.02


def test_only_the_named_arms_move(planner, segments):
    for segment in segments:
        for arm in ("left", "right"):
            q = segment.trajectory.positions[:, planner.sampling.workcell.joints(arm)]
            assert (np.ptp(q, axis=0).max() > 1e-9) == (arm in segment.movers)


def test_a_gripped_plate_stays_where_it_is_in_the_hand(planner, segments, flange):
    for segment in segments:
        if segment.grip is None or segment.kind in (SegmentKind.GRIP, SegmentKind.RELEASE):
            continue
        hand = planner.sampling.workcell.arm(segment.grip.arm).hand
        for sample in np.linspace(0, len(segment.trajectory.time) - 1, 12).astype(int):
            T_world_flange = flange(segment.grip.arm, segment.trajectory.positions[sample])
            T_flange_body = np.linalg.inv(T_world_flange) @ segment.T_world_body[sample]
            assert T_flange_body == pytest.approx(segment.grip.T_flange_body, abs=1e-5)
            T_flange_tcp = hand.T_flange_tcp(segment.grip.width)
            assert T_flange_body @ segment.grip.T_body_tcp == pytest.approx(T_flange_tcp, abs=1e-5)


def test_a_pushing_tip_stays_on_its_point_of_the_plate(planner, segments, flange):
    for segment in segments:
        if segment.push is None:
            continue
        hand = planner.sampling.workcell.arm(segment.push.arm).hand
        for sample in np.linspace(0, len(segment.trajectory.time) - 1, 12).astype(int):
            T_world_body = segment.T_world_body[sample]
            tip = (flange(segment.push.arm, segment.trajectory.positions[sample]) @ hand.T_flange_tcp)[:3, 3]
            touch = tip + hand.tip_radius * T_world_body[:3, :3] @ segment.push.normal
            assert touch == pytest.approx(T_world_body[:3, :3] @ segment.push.point + T_world_body[:3, 3], abs=1e-5)


def test_the_plate_rests_unless_it_is_transferred_and_then_it_stands_on_what_touches(planner, segments):
    for segment in segments:
        if segment.kind in STILL:
            assert np.ptp(segment.T_world_body, axis=0).max() == 0.0
        corners = np.einsum("nij,vj->nvi", segment.T_world_body[:, :3, :3], segment.contact_points)
        heights = corners[:, :, 2] + segment.T_world_body[:, None, 2, 3]
        assert np.abs(heights - planner.scene.support_top).max(initial=0.0) <= 5e-4
        lowest = np.einsum("nj,vj->nv", segment.T_world_body[:, 2, :3], planner.sampling.prism.polyhedron.vertices)
        assert (lowest.min(axis=1) + segment.T_world_body[:, 2, 3]).min() >= planner.scene.support_top - 5e-4


def test_contact_sets_stand_at_the_ends_and_close_enough_together(planner, segments):
    com = planner.scene.plate.com
    for segment in segments:
        samples = [each.sample for each in segment.contact_sets]
        assert samples[0] == 0
        assert samples[-1] == len(segment.trajectory.time) - 1
        assert samples == sorted(set(samples))
        for a, b in pairwise(samples):
            T_a, T_b = segment.T_world_body[a], segment.T_world_body[b]
            assert rotation_angle(T_a[:3, :3], T_b[:3, :3]) <= np.radians(2.0)
            assert np.linalg.norm(T_a[:3, :3] @ com + T_a[:3, 3] - T_b[:3, :3] @ com - T_b[:3, 3]) <= 0.010
            if segment.kind in STILL:
                assert segment.trajectory.time[b] - segment.trajectory.time[a] <= 0.25


def test_every_contact_set_is_in_balance_with_the_weight_and_has_the_hands_that_hold(planner, segments):
    """Forces and moments summed again, in the world."""
    plate = planner.scene.plate
    for segment in segments:
        for each in segment.contact_sets:
            T, balance = segment.T_world_body[each.sample], each.balance
            com = T[:3, :3] @ plate.com + T[:3, 3]
            force = np.array([0.0, 0.0, -9.81 * plate.mass])
            moment = np.zeros(3)
            for place, wrench in zip(balance.points, balance.wrenches_world, strict=True):
                point = T[:3, :3] @ place + T[:3, 3]
                force += wrench[:3]
                moment += wrench[3:] + np.cross(point - com, wrench[:3])
            assert np.linalg.norm(force) < 1e-3
            assert np.linalg.norm(moment) < 1e-3
            assert ("grip_0" in balance.contacts) == (segment.grip is not None)
            assert ("push" in balance.contacts) == (segment.push is not None)


def test_nothing_penetrates_at_random_samples(planner, segments, holding_cell, open_cell):
    """Oracle: fcl, at full depth; what holds the plate may touch it."""
    cell, rng = planner.sampling.workcell, np.random.default_rng(11)
    arms = {"left", "right"}

    def matters(a, b) -> bool:
        return bool({a.group, b.group} & arms) or cell.lifted(a, b)

    for segment in segments:
        if segment.kind in (SegmentKind.GRIP, SegmentKind.RELEASE):
            continue
        bodies = holding_cell if segment.widths[cell.gripper][0] == cell.grip_width else open_cell
        hands = [hold.arm for hold in (segment.grip, segment.push) if hold is not None]
        if segment.kind in (SegmentKind.APPROACH, SegmentKind.RETREAT):
            hands += segment.movers
        for sample in rng.integers(0, len(segment.trajectory.time), 3):
            q, T_world_plate = segment.trajectory.positions[sample], segment.T_world_body[sample]
            assert bodies.least_slack(q, T_world_plate, matters, hands, 0.0) > -1e-5


def test_it_ends_gripped_pushed_off_the_support_and_as_high_as_asked(planner, segments):
    last = segments[-1]
    assert last.grip is not None
    assert last.push is not None
    assert last.contact.element == "none"
    corners = planner.sampling.prism.polyhedron.vertices @ last.T_world_body[-1, 2, :3] + last.T_world_body[-1, 2, 3]
    assert corners.min() >= planner.scene.support_top + planner.settings.sampling.goal_height - 1e-9


def test_the_gripper_closes_and_opens_only_where_it_grips_and_releases(planner, segments):
    closed, opened = planner.sampling.workcell.grip_width, planner.sampling.workcell.open_width
    for segment in segments:
        width = segment.widths[planner.sampling.workcell.gripper]
        if segment.kind is SegmentKind.GRIP:
            assert (width[0], width[-1]) == (opened, closed)
        elif segment.kind is SegmentKind.RELEASE:
            assert (width[0], width[-1]) == (closed, opened)
        else:
            assert set(width) == {closed if segment.grip is not None else opened}


@pytest.mark.slow
def test_an_arm_that_finds_no_way_back_stays_where_it_retreated_to(monkeypatch: pytest.MonkeyPatch) -> None:
    """The plan without that way is certified as any other."""
    find, asked = FreeMotion.find, []
    start = load_cell("dual_ur3e_lift").home

    def find_unless_home(
        self: FreeMotion, move: FreeMove, checker: EdgeChecker | None = None
    ) -> tuple[BlendedPath, int]:
        if np.array_equal(move.goals, start[None, move.joints]):
            asked.append(move.mover)
            raise Stuck(Rejection("transit", "no way back"))
        return find(self, move, checker)

    task = read_task(task_body("ab3", remedies=False))
    parked = solve(task)
    monkeypatch.setattr(FreeMotion, "find", find_unless_home)
    staying = solve(task)
    assert asked
    assert staying.outcome == parked.outcome == "solved"
    assert staying.certificate is not None
    assert staying.certificate.passed
    assert len(staying.segments) < len(parked.segments)
