"""What holds bear the plate, against program (5) stated in cvxpy."""

from __future__ import annotations

import itertools

import cvxpy as cp
import numpy as np
import pytest

from planners.balance.balanced import Balanced
from tests.support.balance_statement import Plate, solve_stated, state_balance


@pytest.fixture(scope="module")
def borne(planner):
    """Ask cvxpy how many times the weight (5) has a solution for, two at most: of the plate as stated, and of the
    heaviest ones with their centre of mass at every corner of its box, the one that is borne least."""
    program, holds = planner.balance.balance, planner.balance
    scene = planner.scene
    plate = Plate(
        scene.plate.mass, scene.plate.com, program.cup, program.friction, program.limits, scene.lifter_model, 9.81
    )
    corners = scene.com_tolerance * np.array(list(itertools.product((-1.0, 1.0), repeat=3)))

    def ask(T_world_plate: np.ndarray, points: np.ndarray, hands) -> float:
        grip = None if hands[0] is None else holds.grips[hands[0]]
        push = None if hands[1] is None else holds.pushes[hands[1]]
        statement = state_balance(plate, T_world_plate[:3, :3], points, grip, push)
        load, times = cp.Parameter(6), cp.Variable()
        problem = cp.Problem(cp.Maximize(times), [statement.total + times * load == 0, times <= 2, *statement.limits])
        weight = -plate.mass * 9.81 * T_world_plate[2, :3]
        heaviest = (1.0 + scene.mass_tolerance) * weight
        factors = []
        for force, offset in ((weight, np.zeros(3)), *((heaviest, corner) for corner in corners)):
            load.value = np.concatenate([force, np.cross(offset, force)])
            factors.append(solve_stated(problem))
        return min(factors)

    return ask


def tried_motions(planner, *, borne: bool, count: int):
    """Motions with hands, sampled from the graph's own edges between poses that can be held."""
    graph = planner.search.graph
    rng = np.random.default_rng(7)
    for edge in rng.permutation(np.flatnonzero(graph.edge_motion >= 0)):
        nodes = graph.edge_nodes[edge]
        if not (graph.knowledge.status[nodes] == 1).all():
            continue
        grip, push = graph.hold_of(int(nodes[0]))
        hands = (grip and grip.index, push and push.index)
        if (planner.balance.along(int(graph.edge_motion[edge]), hands) is None) == borne:
            yield planner.reach.follower.motion(int(graph.edge_motion[edge])), hands
            count -= 1
        if not count:
            return


def held(programs, T_world_plate: np.ndarray, points: np.ndarray, hands) -> bool:
    """Solve anew for the plate as stated, and ask for all others within the tolerances."""
    stated = isinstance(programs.solve(T_world_plate, points, hands), Balanced)
    return stated and programs.refusal(T_world_plate, points, hands) is None


@pytest.mark.slow
def test_where_a_hold_bears_the_plate_along_a_motion_it_does_so_in_between_the_samples_too(planner, borne):
    for motion, hands in tried_motions(planner, borne=True, count=5):
        for s in np.linspace(0.003, 0.997, 12):
            assert borne(motion.pose(s), motion.contact_points, hands) >= 1.0 - 1e-6


@pytest.mark.slow
def test_where_it_does_not_there_is_a_pose_on_the_way_that_cannot_be_held(planner, borne):
    refused = list(tried_motions(planner, borne=False, count=4))
    assert refused
    for motion, hands in refused:
        parameters = planner.balance.sampling.parameters(motion)
        # On the border of what can be held, a plate counts as not held.
        assert min(borne(motion.pose(s), motion.contact_points, hands) for s in parameters) < 1.0 + 1e-4


def test_a_hold_bears_the_plate_along_a_motion_exactly_when_it_does_at_every_sample(planner):
    """Whatever was remembered or proven on the way: each sample solved anew decides."""
    rng, verdicts = np.random.default_rng(13), []
    programs = planner.balance
    for number in rng.permutation(len(planner.sampling.poses.edges))[:60]:
        motion = planner.reach.follower.motion(int(number))
        for hands in ((int(rng.integers(30)), int(rng.integers(64))), (None, int(rng.integers(64)))):
            poses = motion.poses(programs.sampling.parameters(motion))
            borne = all(held(programs, T, motion.contact_points, hands) for T in poses)
            verdicts.append(borne)
            assert (programs.along(int(number), hands) is None) == borne
            # Asked again, it is remembered.
            assert (programs.along(int(number), hands) is None) == borne
    assert 5 < sum(verdicts) < len(verdicts) - 5


def test_samples_lie_strictly_inside_a_motion_and_closer_than_the_settings_say(planner):
    sampling = planner.balance.sampling
    for number in range(0, len(planner.sampling.poses.edges), 97):
        motion = planner.reach.follower.motion(number)
        s = sampling.parameters(motion)
        assert 0.0 < s[0] < s[-1] < 1.0
        com = planner.sampling.poses.plate.com_world(motion.poses(s))
        # The way of the centre of mass is not even in s; an upper bound of its unevenness is 2 here.
        assert np.linalg.norm(np.diff(com, axis=0), axis=1).max() <= 2.0 * sampling.com_step


def test_what_proofs_rule_out_really_cannot_be_held(planner):
    balance = planner.balance
    rng = np.random.default_rng(8)
    ruled_out = rng.permutation(np.argwhere(balance.ruled_out))
    assert len(ruled_out) > 1000
    for pose, grip, push in ruled_out[:150]:
        hands = (None if grip == 0 else int(grip) - 1, None if push == 0 else int(push) - 1)
        where = planner.sampling.poses.poses[pose]
        assert not held(balance, where.T_world_plate, where.contact_points, hands)


def test_poses_with_one_tilt_at_two_heights_share_their_answer(planner):
    lifted = planner.sampling.poses.lifted
    low, high = lifted[0], lifted[len(lifted) // 2]
    assert planner.sampling.poses.poses[low].tilt == pytest.approx(planner.sampling.poses.poses[high].tilt)
    assert planner.balance.at(low, (0, 0)) is planner.balance.at(high, (0, 0))


def test_every_node_of_the_sequence_is_borne_by_its_hands(planner, solved, borne):
    for step in solved.steps[:: max(1, len(solved.steps) // 6)]:
        pose = planner.sampling.poses.poses[step.pose]
        assert borne(pose.T_world_plate, pose.contact_points, step.hands) >= 1.0 - 1e-6
        answer = planner.balance.at(step.pose, step.hands)
        assert isinstance(answer, Balanced)
        assert answer.f_plus_gp == pytest.approx(step.force)
