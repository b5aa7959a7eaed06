"""Examined on demand or beforehand, the sequence is the same; and it is the one the objective asks for."""

from __future__ import annotations

from bisect import bisect_left

import networkx as nx
import numpy as np
import pytest

from planners.graph.rejections import Rejections
from planners.graph.search import ALIVE, RESOLUTION, UNKNOWN
from planners.manipulation.graph.manipulation_graph import HandHold, build_graph
from planners.manipulation.graph.node_examiner import NodeExaminer, hands_of
from planners.manipulation.planner import PlateLiftPlanner
from planners.manipulation.reach.hand_reach import bits
from planners.plan.verdicts import PlanningOutcome
from tests.manipulation.lift_probe import planner_of, task_body
from tests.manipulation.test_reach import pairs_of_postures


@pytest.fixture(scope="module")
def full():
    planner = planner_of(task_body("ab3", search="full"))
    return planner, planner.plan()


@pytest.fixture(scope="module")
def gentle():
    planner = planner_of(task_body("ab3", minimise="force"))
    return planner, planner.plan()


def test_a_full_search_examines_every_node_and_a_lazy_one_leaves_some(full, planner):
    assert not (full[0].search.graph.knowledge.status == UNKNOWN).any()
    assert (planner.search.graph.knowledge.status == UNKNOWN).any()


def test_lazy_and_full_give_the_same_sequence_and_the_same_motion(full, solved):
    plan = full[1]
    assert [(s.pose, s.hands) for s in plan.steps] == [(s.pose, s.hands) for s in solved.steps]
    assert plan.search["cost"] == solved.search["cost"]
    assert len(plan.segments) == len(solved.segments)
    for ours, theirs in zip(plan.segments, solved.segments, strict=True):
        assert ours.kind is theirs.kind
        assert np.array_equal(ours.trajectory.positions, theirs.trajectory.positions)
        assert np.array_equal(ours.trajectory.time, theirs.trajectory.time)


def test_a_lazy_search_knows_of_every_node_what_a_full_one_knows(full, planner):
    """Nodes mean the same in both graphs as the same holds were split.

    That not every plate within the tolerances is held is asked of sequences only, and its proofs are tested against
    nodes that are not examined yet: who examines later knows of more of these nodes.
    """
    lazy, whole = planner.search.graph.knowledge, full[0].search.graph.knowledge
    assert (planner.search.graph.grips, planner.search.graph.pushes) == (
        full[0].search.graph.grips,
        full[0].search.graph.pushes,
    )
    known = lazy.status != UNKNOWN
    assert known.sum() > 1000
    differing = np.flatnonzero(known & (lazy.status != whole.status))
    assert len(differing) < 0.1 * known.sum()
    for node in differing:
        hands = hands_of(*planner.search.graph.hold_of(int(node)))
        assert planner.balance.refusal_at(int(planner.search.graph.node_pose[node]), hands) is not None
    alive = (lazy.status == ALIVE) & (whole.status == ALIVE)
    assert np.abs(lazy.load[alive] - whole.load[alive]).max() * RESOLUTION <= 2e-6


def reference(planner: PlateLiftPlanner) -> nx.DiGraph:
    """What is left of a fully examined graph, every arc with its full cost."""
    graph, knowledge = planner.search.graph.graph, planner.search.graph.knowledge
    tails = np.repeat(np.arange(graph.node_count), np.diff(graph.row_start))
    cost = graph.cost + np.where(graph.loaded, knowledge.load[tails] + knowledge.load[graph.head], 0)
    alive = (knowledge.status[tails] == ALIVE) & (knowledge.status[graph.head] == ALIVE)
    alive &= ~knowledge.edge_dead[graph.edge]
    result = nx.DiGraph()
    result.add_nodes_from(n for n in planner.search.graph.starts if knowledge.status[n] == ALIVE)
    result.add_weighted_edges_from(
        zip(tails[alive].tolist(), graph.head[alive].tolist(), cost[alive].tolist(), strict=True)
    )
    return result


def open_starts(planner: PlateLiftPlanner) -> list[int]:
    status = planner.search.graph.knowledge.status
    return [n for n in planner.search.graph.starts if n not in planner.search.graph.lost_starts and status[n] == ALIVE]


@pytest.mark.slow
def test_the_sequence_is_the_least_forceful_of_the_starts_cheapest_ones():
    """Oracle: Dijkstra of networkx from every start, before anything is tried out."""
    planner = planner_of(task_body("ab1", search="full"))
    planner.begin()
    chosen = planner.search.best_path()
    assert chosen is not None
    arcs = reference(planner)
    for start in open_starts(planner):
        distances = nx.single_source_dijkstra_path_length(arcs, start)
        cheapest = min((d for n, d in distances.items() if planner.search.graph.goal[n]), default=None)
        found = planner.search.paths[start]
        assert (found and found.cost) == (cheapest and pytest.approx(cheapest * RESOLUTION))
    paths = [path for path in planner.search.paths.values() if path is not None]
    assert len(paths) > 1
    forces = [max(planner.search.examiner.largest_force(n) for n in path.nodes) for path in paths]
    assert chosen is paths[int(np.argmin(forces))]


def test_minimised_force_is_no_larger_than_that_of_the_cheapest_sequence(gentle, solved):
    assert gentle[1].outcome is PlanningOutcome.SOLVED
    assert gentle[1].search["max_force"] <= solved.search["max_force"] + 1e-6


@pytest.mark.slow
def test_minimised_force_is_the_smallest_that_any_sequence_left_over_needs(gentle):
    """Oracle: the smallest threshold at which networkx still connects a start with a goal."""
    planner, plan = gentle
    planner.search.examiner.examine_all(lambda *_: None)
    arcs, goal = reference(planner), planner.search.graph.goal
    forces = {n: planner.search.examiner.largest_force(n) for n in arcs}
    limits, starts = sorted(set(forces.values())), open_starts(planner)

    def connects(limit: float) -> bool:
        part = arcs.subgraph([n for n in arcs if forces[n] <= limit])
        return any(goal[m] for n in starts if n in part for m in nx.descendants(part, n))

    # What a threshold connects, every larger one does.
    first = bisect_left(limits, True, key=connects)
    assert first < len(limits), "no threshold connects start and goal"
    assert plan.search["max_force"] == pytest.approx(limits[first], abs=2e-6)


def test_the_load_of_a_node_is_the_torque_of_its_least_loaded_postures(planner):
    """Oracle: both hands' wrenches from the balance, put through every posture one by one."""
    graph = planner.search.graph
    rng = np.random.default_rng(10)
    for node in rng.permutation(np.flatnonzero(graph.knowledge.status == ALIVE))[:30]:
        pose, (grip, push) = int(graph.node_pose[node]), graph.hold_of(int(node))
        hands = (grip and grip.index, push and push.index)
        answer, T = planner.balance.at(pose, hands), planner.sampling.poses.poses[pose].T_world_plate
        total = 0.0
        for hold, reach, table, names in (
            (grip, planner.reach.pair.first, planner.reach.reached.grip, ("grip_0", "grip_1")),
            (push, planner.reach.pair.second, planner.reach.reached.push, ("push",)),
        ):
            if hold is None:
                continue
            origin = T[:3, 3].copy()
            wrench = np.zeros(6)
            for contact in (answer.contacts.index(name) for name in names):
                point = T[:3, :3] @ answer.points[contact] + T[:3, 3]
                exerted = answer.wrenches_world[contact]
                wrench[:3] += exerted[:3]
                wrench[3:] += exerted[3:] + np.cross(point - origin, exerted[:3])
            postures = bits(int(table[pose, hold.index]) & hold.postures)
            total += min(reach.least_load(T, hold.index, 1 << each, wrench, origin) for each in postures)
        assert graph.knowledge.load[node] * RESOLUTION == pytest.approx(total, abs=2e-6)


class WillingBalance:
    """Everything is borne, always by the same wrenches."""

    def __init__(self, planner: PlateLiftPlanner, answer) -> None:
        self.balance, self.answer = planner.balance.balance, answer
        self.ruled_out = np.zeros_like(planner.balance.ruled_out)

    def at(self, pose, hands):
        return self.answer


@pytest.mark.slow
def test_a_node_is_dead_when_the_arms_touch_in_every_pair_of_its_postures(planner, solved):
    """Holds of one posture each, of which the arms are known to touch, or not to."""
    reached = planner.reach.reached
    answer = next(a for step in solved.steps if "grip_0" in (a := planner.balance.at(step.pose, step.hands)).contacts)
    assert "push" in answer.contacts
    for pose, numbers, postures, apart in pairs_of_postures(planner, 9):
        grip, push = (HandHold(number, 1 << posture) for number, posture in zip(numbers, postures, strict=True))
        graph = build_graph(planner.sampling.poses, (grip,), (push,), *reached.sets, planner.settings.costs)
        examine = NodeExaminer(graph, WillingBalance(planner, answer), reached, Rejections(), "cost")
        (node,) = np.flatnonzero((graph.node_pose == pose) & (graph.node_grip > 0) & (graph.node_push > 0))
        examine(int(node))
        assert (graph.knowledge.status[node] == ALIVE) == (apart is not None)
