"""Reach against pinocchio's kinematics and python-fcl's distances."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from planners.collision.model import Fixed
from planners.manipulation.reach.hand_reach import ALL_POSTURES, CONTINUITY, bits
from planners.manipulation.reach.reached_postures import ReachedPostures
from tests.kinematics.arm_oracle import PinocchioArm
from tests.manipulation.lift_probe import TURN

NEAR = 1e-5
"""Distances closer than this to their limit decide nothing [m]."""


@pytest.fixture(params=["grip", "push"])
def hand(request, planner):
    """One hand: its reach, and what it reached at all poses."""
    first = request.param == "grip"
    return (
        (planner.reach.pair.first, planner.reach.reached.grip, planner.sampling.workcell.gripper)
        if first
        else (planner.reach.pair.second, planner.reach.reached.push, planner.sampling.workcell.pusher)
    )


def flange(reach, q: np.ndarray) -> np.ndarray:
    return reach.arm.T_world_base @ PinocchioArm(reach.arm.dh).flange_pose(q)


def within_limits(reach, q: np.ndarray) -> bool:
    turned = q + TURN * np.array([[-1], [0], [1]])
    return bool(((turned >= reach.arm.position_min) & (turned <= reach.arm.position_max)).any(axis=0).all())


def pose_of(planner, number: int) -> np.ndarray:
    return planner.sampling.poses.poses[number].T_world_plate


def with_arm(planner, reach, q: np.ndarray) -> np.ndarray:
    positions = planner.scene.start_positions.copy()
    positions[reach.first_joint : reach.first_joint + 6] = q
    return positions


def test_a_posture_reaches_a_pose_exactly_when_fcl_finds_its_configuration_free(planner, holding_cell, hand):
    reach, reached, arm = hand
    rng = np.random.default_rng(1)
    only, verdicts = planner.sampling.workcell.without_other(arm), []
    # Half of the samples are known to reach; of all others most do not.
    known = rng.permutation(np.argwhere(reached))[:12]
    for pose, hold in (*known, *rng.integers(0, reached.shape, (12, 2))):
        for posture in rng.permutation(8 * reach.T_plate_flange.shape[1])[:24]:
            q = reach.follow(pose_of(planner, pose)[None], hold, posture)[0]
            free = bool(np.isfinite(q).all()) and within_limits(reach, q)
            if free:
                positions = with_arm(planner, reach, q)
                slack = holding_cell.least_slack(positions, pose_of(planner, pose), only, [arm], 0.003)
                if abs(slack) < NEAR:
                    continue
                free = slack > 0.0
            verdicts.append(free)
            assert free == bool(int(reached[pose, hold]) >> int(posture) & 1)
    assert 10 < sum(verdicts) < len(verdicts) - 10


def test_a_posture_puts_the_hand_where_its_hold_says_in_one_branch_all_along(planner, hand):
    """Oracle: pinocchio; and the branch is the same one at every sample."""
    reach, reached, _ = hand
    rng = np.random.default_rng(2)
    for pose, hold in rng.permutation(np.argwhere(reached))[:30]:
        for posture in bits(int(reached[pose, hold]))[:4]:
            T_world_plate = pose_of(planner, pose)
            q = reach.follow(T_world_plate[None], hold, posture)[0]
            expected = T_world_plate @ reach.T_plate_flange[hold, posture // 8]
            assert flange(reach, q) == pytest.approx(expected, abs=1e-9)
    reference = q + TURN * np.array([1, -1, 0, 1, 0, -1])
    assert reach.follow(T_world_plate[None], hold, posture, reference[None])[0] == pytest.approx(reference)


def test_a_hold_is_hindered_at_a_pose_exactly_when_none_of_its_postures_reaches_it(planner, hand):
    reach, reached, _ = hand
    for pose in (0, 60, 140):
        for hold in range(reach.hold_count):
            assert (reach.hindrance(pose_of(planner, pose), hold) is None) == bool(reached[pose, hold])


def motions_with_postures(planner, hand, count: int, seed: int):
    _, reached, _ = hand
    rng = np.random.default_rng(seed)
    for number in rng.permutation(len(planner.sampling.poses.edges)):
        i, j = planner.sampling.poses.edges[number]
        holds = np.flatnonzero(reached[i] & reached[j])
        if len(holds):
            hold = int(rng.choice(holds))
            yield planner.reach.follower.samples(int(number)), hold, int(reached[i, hold] & reached[j, hold])
            count -= 1
        if not count:
            return


def test_postures_that_pass_a_motion_are_free_and_continuous_at_every_sample_and_the_others_are_not(planner, hand):
    """Oracle: a query made anew at every sample, and the joints' differences."""
    reach, _, arm = hand
    cell, verdicts = planner.sampling.workcell, []
    rng = np.random.default_rng(9)
    for samples, hold, postures in motions_with_postures(planner, hand, 12, 3):
        # Postures that reach both ends, and others, which do not.
        others = rng.integers(0, 8 * reach.T_plate_flange.shape[1], 8)
        postures |= sum({1 << int(posture) for posture in others})
        passed = reach.track(samples, hold, postures, reach.alone)
        assert passed & ~postures == 0
        queries = [cell.query(cell.holding, cell.without_other(arm), Fixed(T), hands=[arm]) for T in samples]
        for posture in bits(postures):
            q = reach.follow(samples, hold, posture)
            good = bool(np.isfinite(q).all())
            good = good and float(np.abs(np.diff(q, axis=0)).max()) <= CONTINUITY
            good = good and all(within_limits(reach, row) for row in q)
            good = good and all(
                query.first_collision(with_arm(planner, reach, row)[None])[0] < 0
                for query, row in zip(queries, q, strict=True)
            )
            verdicts.append(good)
            assert good == bool(passed >> posture & 1)
    assert 0 < sum(verdicts) < len(verdicts)


def test_followed_joints_reach_every_sample_of_a_motion_without_a_jump(planner, hand):
    reach, _, _ = hand
    for samples, hold, postures in motions_with_postures(planner, hand, 8, 4):
        for posture in bits(reach.track(samples, hold, postures, reach.alone))[:2]:
            q = reach.follow(samples, hold, posture)
            assert np.abs(np.diff(q, axis=0)).max() <= CONTINUITY
            for T_world_plate, row in zip(samples, q, strict=True):
                expected = T_world_plate @ reach.T_plate_flange[hold, posture // 8]
                assert flange(reach, row) == pytest.approx(expected, abs=1e-8)


def test_loads_are_the_joint_torques_of_virtual_work(planner, hand):
    """Oracle: pinocchio's Jacobian, the wrench moved to the flange."""
    reach, reached, _ = hand
    rng = np.random.default_rng(5)
    R_base = reach.arm.T_world_base[:3, :3]
    for pose, hold in rng.permutation(np.argwhere(reached))[:20]:
        postures = int(reached[pose, hold])
        wrench, point = rng.normal(size=6), pose_of(planner, pose)[:3, 3] + rng.normal(size=3) * 0.1
        loads = [reach.least_load(pose_of(planner, pose), hold, 1 << each, wrench, point) for each in range(64)]
        assert np.flatnonzero(np.isfinite(loads)).tolist() == bits(postures)
        for known in (0, postures, 1 << bits(postures)[0]):
            # Nothing is remembered of what was asked before.
            anew = replace(reach)
            for _ in range(2):
                assert anew.least_load(pose_of(planner, pose), hold, ALL_POSTURES, wrench, point, known) == min(loads)
        for posture in bits(postures):
            q = reach.follow(pose_of(planner, pose)[None], hold, posture)[0]
            lever = point - flange(reach, q)[:3, 3]
            at_flange = np.concatenate([wrench[:3], wrench[3:] + np.cross(lever, wrench[:3])])
            in_base = np.concatenate([R_base.T @ at_flange[:3], R_base.T @ at_flange[3:]])
            torques = PinocchioArm(reach.arm.dh).jacobian(q).T @ in_base
            assert loads[posture] == pytest.approx(np.abs(torques).sum(), rel=1e-6)


def weighed(arm) -> tuple[pin.Model, int]:
    """The arm with its hand in pinocchio, mounted; and the number of its flange."""
    oracle = PinocchioArm(arm.dh)
    model = oracle.model
    base = pin.SE3(arm.T_world_base)
    model.jointPlacements[1] = base * model.jointPlacements[1]
    for number, (mass, *com) in enumerate(arm.masses):
        a, alpha, d, _ = arm.dh[min(number, 5)]
        frame = pin.SE3(pin.utils.rotate("x", alpha), np.array([a, 0.0, d]))
        model.appendBodyToJoint(min(number, 5) + 1, pin.Inertia(mass, np.array(com), np.zeros((3, 3))), frame)
    return model, oracle.flange


def test_torque_shares_are_those_of_arm_hand_and_wrench_at_the_worst_of_the_poses(planner, hand):
    """Oracle: pinocchio's generalised gravity and Jacobian."""
    reach, *_ = hand
    rng, verdicts = np.random.default_rng(8), []
    model, flange_frame = weighed(reach.arm)
    data, gravity = model.createData(), planner.scene.cell.gravity
    model.gravity.linear = gravity
    for samples, hold, postures in motions_with_postures(planner, hand, 8, 7):
        postures &= reach.track(samples, hold, postures, reach.alone)
        plates = samples[:: max(1, len(samples) // 3)]
        wrenches = (
            rng.normal(size=(len(plates), 6)) * rng.choice([0.2, 1.0]) * np.array([30.0, 30.0, 30.0, 2.0, 2.0, 2.0])
        )
        points = plates[:, :3, 3] + rng.normal(size=(len(plates), 3)) * 0.1
        shares = reach.torque_shares(plates, hold, postures, wrenches, points, gravity)
        within = reach.within_torque(plates, hold, postures, wrenches, points, gravity, 0.2)
        assert np.flatnonzero(np.isfinite(shares).all(axis=1)).tolist() == bits(postures)
        for posture in bits(postures):
            used = []
            for q, wrench, point in zip(reach.follow(plates, hold, posture), wrenches, points, strict=True):
                pin.forwardKinematics(model, data, q)
                lever = point - pin.updateFramePlacement(model, data, flange_frame).translation
                J = pin.computeFrameJacobian(model, data, q, flange_frame, pin.LOCAL_WORLD_ALIGNED)
                at_flange = np.concatenate([wrench[:3], wrench[3:] + np.cross(lever, wrench[:3])])
                torques = pin.computeGeneralizedGravity(model, data, q) + J.T @ at_flange
                used.append(np.abs(torques) / reach.arm.torque_max)
            assert shares[posture] == pytest.approx(np.max(used, axis=0), rel=1e-6)
            verdicts.append(bool(within >> posture & 1))
            assert verdicts[-1] == (np.max(used) <= 0.8)
    assert 0 < sum(verdicts) < len(verdicts)


def test_a_posture_that_does_not_reach_a_pose_holds_no_torque_there(planner, hand):
    reach, reached, _ = hand
    pose, hold = np.argwhere(reached)[0]
    far = pose_of(planner, pose).copy()
    far[:3, 3] += 3.0
    plates, none = np.stack([pose_of(planner, pose), far]), np.zeros((2, 6))
    postures, gravity = int(reached[pose, hold]), planner.scene.cell.gravity
    assert reach.within_torque(plates[:1], hold, postures, none[:1], none[:1, :3], gravity, 0.05) == postures
    assert reach.within_torque(plates, hold, postures, none, none[:, :3], gravity, 0.05) == 0


def arm_slack(planner, cell, pose, holds, postures) -> float:
    """By how much the arms are farther apart than they have to be [m]."""
    q, pair = np.zeros(12), planner.reach.pair
    for reach, hold, posture in zip((pair.first, pair.second), holds, postures, strict=True):
        q[reach.first_joint : reach.first_joint + 6] = reach.follow(pose_of(planner, pose)[None], hold, posture)[0]
    return cell.least_slack(q, pose_of(planner, pose), planner.sampling.workcell.between_arms, ["left", "right"], 0.003)


def pairs_of_postures(planner, count: int):
    """Yield poses, holds and postures of both hands; a third of as many clash, which few do."""
    rng, wanted = np.random.default_rng(6), {True: count, False: count // 3}
    reached = planner.reach.reached
    both = np.argwhere((reached.grip != 0).any(axis=1) & (reached.push != 0).any(axis=1))[:, 0]
    for _ in range(20_000):
        pose = int(rng.choice(both))
        tables = planner.reach.reached.grip[pose], planner.reach.reached.push[pose]
        holds = tuple(int(rng.choice(np.flatnonzero(table))) for table in tables)
        postures = tuple(int(rng.choice(bits(int(t[h])))) for t, h in zip(tables, holds, strict=True))
        apart = planner.reach.pair.compatible(pose_of(planner, pose)[None], holds, (1 << postures[0], 1 << postures[1]))
        if wanted[apart is not None]:
            wanted[apart is not None] -= 1
            yield pose, holds, postures, apart
        if not any(wanted.values()):
            return
    raise AssertionError("too few pairs of one kind")


@pytest.mark.slow
def test_two_postures_go_together_exactly_when_fcl_keeps_the_arms_apart(planner, holding_cell):
    for pose, holds, postures, apart in pairs_of_postures(planner, 12):
        slack = arm_slack(planner, holding_cell, pose, holds, postures)
        assert apart == (postures if slack > 0.0 else None) or abs(slack) < NEAR


def test_of_sets_of_postures_the_first_pair_that_goes_together_is_found(planner):
    for pose, holds, _, _ in pairs_of_postures(planner, 8):
        where = pose_of(planner, pose)[None]
        sets = int(planner.reach.reached.grip[pose, holds[0]]), int(planner.reach.reached.push[pose, holds[1]])
        pairs = ((a, b) for a in bits(sets[0]) for b in bits(sets[1]))
        first = next((p for p in pairs if planner.reach.pair.compatible(where, holds, (1 << p[0], 1 << p[1]))), None)
        assert planner.reach.pair.compatible(where, holds, sets) == first


def some_plates(planner) -> np.ndarray:
    """Return some of the sampled poses (n, 4, 4), one after the other as planners have them."""
    return planner.sampling.T_world_plates[::9].copy()


def some_reached(planner) -> ReachedPostures:
    """Return what is known at some of the poses before anything is asked."""
    plates = some_plates(planner)
    return ReachedPostures(planner.reach.pair, plates, planner.reach.pair.some_postures(plates, int), whole=False)


def test_what_is_known_of_a_set_is_part_of_it_and_empty_only_if_it_is(planner):
    plates, some = some_plates(planner), some_reached(planner).some
    for reach, known in zip((planner.reach.pair.first, planner.reach.pair.second), some, strict=True):
        every = reach.postures(plates)
        assert not (known & ~every).any()
        np.testing.assert_array_equal(known != 0, every != 0)


def test_a_set_asked_for_by_itself_is_that_of_all_together(planner):
    plates, reached = some_plates(planner), some_reached(planner)
    for hand in ("grip", "push"):
        every = reached.hand(hand).postures(plates)
        entries = np.random.default_rng(7).permutation(np.argwhere(every))
        assert [reached.at(hand, *entry) for entry in entries[:30]] == [int(every[*entry]) for entry in entries[:30]]
        np.testing.assert_array_equal(reached.of_hold(hand, entries[-1, 1]), every[:, entries[-1, 1]])
        np.testing.assert_array_equal(reached.grip if hand == "grip" else reached.push, every)
