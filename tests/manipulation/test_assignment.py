"""Postures of a whole sequence, checked place by place; and conflicts of postures on made-up factors."""

from __future__ import annotations

import itertools
import math
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from planners.manipulation.graph.manipulation_graph import HandHold
from planners.manipulation.motion.assignment import PostureAssigner, _conflict, _parts
from planners.manipulation.motion.manipulation_sequence import HoldPhase
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


def test_no_hand_comes_or_goes_through_the_other_one(planner, assigner, assignments):
    for assignment in assignments[:2]:
        holds = {phase: (phase.hold.index, posture) for phase, posture in assignment.items()}
        for phase in assigner.sequence.phases:
            for changes, place in ((phase.first > 0, phase.first), (phase.goes, phase.last)):
                grip, push = (assigner.sequence.active(hand, place) for hand in ("grip", "push"))
                if changes and grip is not None and push is not None:
                    pose = assigner.sequence.poses[place]
                    assert planner.reach.follower.beside(pose, phase.hand, holds[grip], holds[push]) is None


@pytest.mark.parametrize("coming", ["grip", "push"])
@pytest.mark.slow
def test_a_hand_comes_beside_the_other_one_where_the_arms_keep_apart(planner, holding_cell, open_cell, coming):
    """Asked of python-fcl and pinocchio, at more places of its way."""
    follower, workcell, rng = planner.reach.follower, planner.sampling.workcell, np.random.default_rng(7)
    margin = workcell.settings.executed_share * workcell.settings.margin
    cell, seen = holding_cell if coming == "push" else open_cell, {True: 0, False: 0}
    for _ in range(30000):
        pose = int(rng.integers(len(planner.sampling.poses.poses)))
        index = {hand: int(rng.integers(follower.hand(hand).hold_count)) for hand in ("grip", "push")}
        reached = {hand: bits(follower.reached.at(hand, pose, index[hand])) for hand in ("grip", "push")}
        if not all(reached.values()):
            continue
        held = {hand: (index[hand], int(rng.choice(reached[hand]))) for hand in ("grip", "push")}
        clear = follower.beside(pose, coming, held["grip"], held["push"]) is None
        if seen[clear] >= 8:
            continue
        seen[clear] += 1
        T_world_plate = planner.sampling.poses.poses[pose].T_world_plate
        mover, other = follower.hand(coming), follower.hand("push" if coming == "grip" else "grip")
        carriers = follower.approach_carriers(T_world_plate, coming, index[coming])
        finely = np.repeat(T_world_plate[None], 40, axis=0)
        finely[:, :3, 3] = np.linspace(carriers[0, :3, 3], carriers[-1, :3, 3], 40)
        q = np.zeros(12)
        q[other.joints] = other.follow(T_world_plate[None], *held["push" if coming == "grip" else "grip"])[0]
        slack = []
        for own in mover.follow(finely, *held[coming]):
            q[mover.joints] = own
            slack.append(cell.least_slack(q, T_world_plate, workcell.between_arms, (), margin))
        assert clear == (min(slack) > 0.0) or abs(min(slack)) < 1e-4
        if min(seen.values()) == 8:
            return
    raise AssertionError(f"hands hardly ever meet, or nearly always: {seen}")


class MadeUpAssigner(PostureAssigner):
    """Whether postures fit is drawn at random, the same whenever it is asked."""

    def __init__(self, phases: list[HoldPhase], postures: int, share: float, rng: np.random.Generator) -> None:
        super().__init__(cast(Any, None), cast(Any, SimpleNamespace(phases=tuple(phases))), np.zeros(12), None)
        self._preferred = {phase: rng.permutation(postures).tolist() for phase in phases}
        self._drawn = {
            frozenset((a, b)): rng.random((postures, postures)) < share for a, b in itertools.combinations(phases, 2)
        }
        self.asked, self.most = 0, math.inf

    def _fits(self, a: HoldPhase, posture_a: int, b: HoldPhase, posture_b: int) -> bool:
        self.asked += 1
        assert self.asked <= self.most
        grip, push = ((a, posture_a), (b, posture_b)) if a.hand == "grip" else ((b, posture_b), (a, posture_a))
        return bool(self._drawn[frozenset((a, b))][grip[1], push[1]])


def made_up_phases(rng: np.random.Generator, count: int) -> list[HoldPhase]:
    """Return phases of both hands, each hand's one after the other, with gaps."""
    phases = []
    for hand in ("grip", "push"):
        ends = np.cumsum(rng.integers(1, 4, 2 * count)).tolist()
        phases += [HoldPhase(hand, HandHold(0, 0xF), *place) for place in zip(ends[::2], ends[1::2], strict=True)]
    return phases


@pytest.mark.parametrize("seed", range(20))
def test_assignments_are_all_that_fit_in_the_order_of_preference(seed):
    """By brute force: of every choice of postures those of which each two fit that are on the plate together."""
    rng = np.random.default_rng(seed)
    assigner = MadeUpAssigner(made_up_phases(rng, 3), 3, 0.6, rng)
    ordered = sorted(assigner.sequence.phases, key=lambda each: (each.first, each.hand))
    meeting = [
        (a, b)
        for a, b in itertools.combinations(ordered, 2)
        if a.hand != b.hand and set(range(a.first, a.last + 1)) & set(range(b.first, b.last + 1))
    ]
    fitting = []
    for postures in itertools.product(*(assigner._preferred[phase] for phase in ordered)):
        chosen = dict(zip(ordered, postures, strict=True))
        if all(assigner._fits(a, chosen[a], b, chosen[b]) for a, b in meeting):
            fitting.append(chosen)
    assert list(assigner.assignments()) == fitting


def test_that_no_posture_fits_at_the_end_of_a_long_sequence_is_found_without_trying_all_choices():
    rng, count, postures = np.random.default_rng(3), 12, 4
    phases = [
        HoldPhase(hand, HandHold(0, 0xF), 2 * each + late, 2 * each + late + 1)
        for each in range(count)
        for hand, late in (("grip", 0), ("push", 1))
    ]
    assigner = MadeUpAssigner(phases, postures, 1.0, rng)
    assigner._drawn[frozenset(phases[-2:])][:] = False
    # Each pair of postures of two phases that meet, once.
    assigner.most = len(phases) * postures**2
    assert list(assigner.assignments()) == []


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
