"""Plans end where both hands can carry the plate on, straight up."""

from __future__ import annotations

import numpy as np
import pytest

from planners.balance.balanced import Balanced
from planners.graph.search import ALIVE
from planners.kinematics.forward import flange_pose
from planners.manipulation.graph.manipulation_graph import HandHold
from planners.manipulation.reach.hand_reach import BRANCHES, bits
from planners.manipulation.statics.lift_programs import balance_program


@pytest.fixture(scope="module")
def rising(planner):
    return planner.search.rising


def test_postures_that_rise_put_the_hand_where_the_raised_plate_is(planner, rising) -> None:
    """Asked of forward kinematics."""
    checked = 0
    for reach, hand in ((planner.reach.pair.first, "grip"), (planner.reach.pair.second, "push")):
        asked = [(goal, hold) for goal in planner.sampling.poses.goals for hold in range(reach.hold_count)]
        for goal, hold in asked[::5]:
            for posture in bits(rising.postures(goal, hand, hold)):
                for plate in rising.way(goal):
                    q = np.ascontiguousarray(reach.follow(plate[None], hold, posture)[0])
                    wanted = plate @ reach.T_plate_flange[hold, posture // BRANCHES]
                    assert flange_pose(reach.arm.dh, reach.arm.T_world_base, q) == pytest.approx(wanted, abs=1e-6)
                    checked += 1
    assert checked > 20


def test_a_hold_keeps_the_postures_that_reach_every_height_on_the_way_up(planner, rising) -> None:
    for goal in planner.sampling.poses.goals[::4]:
        at_each = planner.reach.pair.second.postures(rising.way(goal))
        for hold in range(0, planner.reach.pair.second.hold_count, 7):
            assert rising.postures(goal, "push", hold) == int(at_each[0, hold] & at_each[1, hold])


def test_goals_that_were_examined_are_borne_with_the_cups_reserve(planner) -> None:
    graph = planner.search.graph
    reserved = balance_program(planner.scene, planner.settings.cup_reserve)
    nodes = np.flatnonzero(graph.goal & (graph.knowledge.status == ALIVE))
    assert len(nodes)
    for node in nodes[:20]:
        grip, push = graph.hold_of(int(node))
        rotation = planner.sampling.poses.poses[graph.node_pose[node]].T_world_plate[:3, :3]
        contacts = planner.balance.grips[grip.index], planner.balance.pushes[push.index]
        answer = reserved.solve(rotation, np.empty((0, 3)), *contacts)
        assert isinstance(answer, Balanced)
        assert answer.suction_force <= (1.0 - planner.settings.cup_reserve) * planner.scene.cup.max_force + 1e-6


def test_a_hold_without_rising_postures_does_not_bear(planner, rising) -> None:
    goal = planner.sampling.poses.goals[0]
    assert not rising.together(goal, HandHold(0, 0), HandHold(0, 0))
