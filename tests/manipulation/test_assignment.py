"""Postures of a whole sequence, checked place by place; and conflicts of postures on made-up factors."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from planners.manipulation.motion.assignment import _conflict, _parts
from planners.manipulation.reach.hand_reach import CONTINUITY, bits


@pytest.fixture(scope="module")
def assignments(assigner):
    return list(itertools.islice(assigner.assignments(), 6))


def table(planner, hand):
    return planner.reach.reached.grip if hand == "grip" else planner.reach.reached.push


def test_hold_phases_are_the_stretches_over_which_a_hand_keeps_its_hold(assigner, solved):
    sequence = assigner.sequence
    for hand, side in (("grip", 0), ("push", 1)):
        for place, step in enumerate(solved.steps):
            active = sequence.active(hand, place)
            assert (active and active.hold.index) == step.hands[side]
        for phase in (e for e in sequence.phases if e.hand == hand):
            assert phase.goes == (phase.last < len(solved.steps) - 1)


def test_a_posture_reaches_all_poses_of_its_hold_phase(planner, assigner, assignments):
    assert assignments
    for assignment in assignments:
        assert set(assignment) == set(assigner.sequence.phases)
        for phase, posture in assignment.items():
            for place in range(phase.first, phase.last + 1):
                pose = assigner.sequence.poses[place]
                assert int(table(planner, phase.hand)[pose, phase.hold.index]) >> posture & 1


def test_a_posture_follows_all_motions_of_its_hold_phase_without_a_jump(planner, assigner, assignments):
    for phase, posture in assignments[0].items():
        reach = planner.reach.follower.hand(phase.hand)
        for place in range(phase.first, phase.last):
            step = assigner.sequence.motions[place]
            if step is not None:
                q = reach.follow(planner.reach.follower.samples(step[0]), phase.hold.index, posture)
                assert np.abs(np.diff(q, axis=0)).max() <= CONTINUITY


def test_hands_that_are_on_the_plate_together_keep_the_arms_apart(planner, assigner, assignments):
    for assignment in assignments[:2]:
        for place in range(len(assigner.sequence.poses)):
            grip, push = (assigner.sequence.active(hand, place) for hand in ("grip", "push"))
            if grip is None or push is None:
                continue
            T = planner.sampling.poses.poses[assigner.sequence.poses[place]].T_world_plate[None]
            masks = 1 << assignment[grip], 1 << assignment[push]
            assert planner.reach.pair.compatible(T, (grip.hold.index, push.hold.index), masks) is not None


@pytest.mark.parametrize("seed", range(30))
def test_a_conflict_leaves_no_posture_and_can_spare_none_of_its_factors(seed):
    rng = np.random.default_rng(seed)
    postures = 0b11111111
    factors = [(int(rng.integers(1, 256)), number) for number in range(6)]
    left = postures
    for survivors, _ in factors:
        left &= survivors
    if left:
        factors.append((postures & ~left, 6))
    conflict = _conflict(postures, factors)
    assert set(conflict) <= set(factors)

    def common(members) -> int:
        result = postures
        for survivors, _ in members:
            result &= survivors
        return result

    assert common(conflict) == 0
    for spared in conflict:
        assert common([other for other in conflict if other != spared]) != 0


@pytest.mark.parametrize("seed", range(10))
def test_parts_are_disjoint_make_up_the_whole_and_agree_about_every_set(seed):
    rng = np.random.default_rng(seed)
    postures, sets = int(rng.integers(1, 2**12)), [int(s) for s in rng.integers(0, 2**12, 3)]
    parts = _parts(postures, sets)
    assert sorted(itertools.chain.from_iterable(bits(part) for part in parts)) == bits(postures)
    for part in parts:
        assert all(part & members in (0, part) for members in sets)
    keys = [tuple(bool(part & members) for members in sets) for part in parts]
    assert len(set(keys)) == len(keys)
