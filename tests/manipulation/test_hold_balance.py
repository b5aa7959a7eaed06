"""What holds bear the plate, against program (5) stated in cvxpy."""

from __future__ import annotations

import numpy as np
import pytest

from planners.balance.balanced import Balanced, Unbalanced
from planners.balance.statement import Plate, state_balance


@pytest.fixture(scope="module")
def feasible(planner):
    """Ask cvxpy whether (5) has a solution."""
    program, holds = planner.balance_program, planner.balance
    scene = planner.scene
    plate = Plate(
        scene.plate.mass, scene.plate.com, program.cup, program.friction, program.limits, scene.lifter_model, 9.81
    )

    def ask(T_world_plate: np.ndarray, points: np.ndarray, hands) -> bool:
        grip = None if hands[0] is None else holds.grips[hands[0]]
        push = None if hands[1] is None else holds.pushes[hands[1]]
        statement = state_balance(plate, T_world_plate[:3, :3], points, grip, push)
        statement.problem.solve(solver="CLARABEL")
        return statement.is_feasible

    return ask


def tried_motions(planner, *, borne: bool, count: int):
    """Motions with hands, sampled from the graph's own edges between poses that can be held."""
    graph = planner.graph
    rng = np.random.default_rng(7)
    for edge in rng.permutation(np.flatnonzero(graph.edge_motion >= 0)):
        nodes = graph.edge_nodes[edge]
        if not (graph.knowledge.status[nodes] == 1).all():
            continue
        grip, push = graph.hold_of(int(nodes[0]))
        hands = (grip and grip.index, push and push.index)
        if (planner.balance.along(int(graph.edge_motion[edge]), hands) is None) == borne:
            yield planner.follower.motion(int(graph.edge_motion[edge])), hands
            count -= 1
        if not count:
            return


def test_where_a_hold_bears_the_plate_along_a_motion_it_does_so_in_between_the_samples_too(planner, feasible):
    for motion, hands in tried_motions(planner, borne=True, count=5):
        for s in np.linspace(0.003, 0.997, 12):
            assert feasible(motion.pose(s), motion.contact_points, hands)


def test_where_it_does_not_there_is_a_pose_on_the_way_that_cannot_be_held(planner, feasible):
    refused = list(tried_motions(planner, borne=False, count=4))
    assert refused
    for motion, hands in refused:
        parameters = planner.balance.sampling.parameters(motion)
        assert not all(feasible(motion.pose(s), motion.contact_points, hands) for s in parameters)


def test_a_hold_bears_the_plate_along_a_motion_exactly_when_it_does_at_every_sample(planner):
    """Whatever was remembered or proven on the way: each sample solved anew decides."""
    rng, verdicts = np.random.default_rng(13), []
    programs = planner.balance
    for number in rng.permutation(len(planner.poses.edges))[:60]:
        motion = planner.follower.motion(int(number))
        for hands in ((int(rng.integers(30)), int(rng.integers(64))), (None, int(rng.integers(64)))):
            poses = motion.poses(programs.sampling.parameters(motion))
            borne = all(isinstance(programs.solve(T, motion.contact_points, hands), Balanced) for T in poses)
            verdicts.append(borne)
            assert (programs.along(int(number), hands) is None) == borne
            # Asked again, it is remembered.
            assert (programs.along(int(number), hands) is None) == borne
    assert 5 < sum(verdicts) < len(verdicts) - 5


def test_samples_lie_strictly_inside_a_motion_and_closer_than_the_settings_say(planner):
    sampling = planner.balance.sampling
    for number in range(0, len(planner.poses.edges), 97):
        motion = planner.follower.motion(number)
        s = sampling.parameters(motion)
        assert 0.0 < s[0] < s[-1] < 1.0
        com = planner.poses.plate.com_world(motion.poses(s))
        # The way of the centre of mass is not even in s; an upper bound of its unevenness is 2 here.
        assert np.linalg.norm(np.diff(com, axis=0), axis=1).max() <= 2.0 * sampling.com_step


def test_what_proofs_rule_out_really_cannot_be_held(planner):
    balance = planner.balance
    rng = np.random.default_rng(8)
    ruled_out = rng.permutation(np.argwhere(balance.ruled_out))
    assert len(ruled_out) > 1000
    for pose, grip, push in ruled_out[:150]:
        hands = (None if grip == 0 else int(grip) - 1, None if push == 0 else int(push) - 1)
        where = planner.poses.poses[pose]
        assert isinstance(balance.solve(where.T_world_plate, where.contact_points, hands), Unbalanced)


def test_poses_with_one_tilt_at_two_heights_share_their_answer(planner):
    lifted = planner.poses.lifted
    low, high = lifted[0], lifted[len(lifted) // 2]
    assert planner.poses.poses[low].tilt == pytest.approx(planner.poses.poses[high].tilt)
    assert planner.balance.at(low, (0, 0)) is planner.balance.at(high, (0, 0))


def test_every_node_of_the_sequence_is_borne_by_its_hands(planner, solved, feasible):
    for step in solved.steps[:: max(1, len(solved.steps) // 6)]:
        pose = planner.poses.poses[step.pose]
        assert feasible(pose.T_world_plate, pose.contact_points, step.hands)
        answer = planner.balance.at(step.pose, step.hands)
        assert isinstance(answer, Balanced)
        assert answer.largest_hand_normal == pytest.approx(step.force)
