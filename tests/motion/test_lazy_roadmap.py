"""A roadmap of drawn postures against networkx, which is told everything that the roadmap finds out by asking."""

from __future__ import annotations

from dataclasses import dataclass

import networkx as nx
import numpy as np
import pytest

from planners.motion.joint_metric import JointMetric
from planners.motion.lazy_roadmap import RoadmapSettings, find_way
from planners.motion.path_search import plan_motion
from planners.motion.query import MotionOutcome, MotionQuery, MotionSettings
from tests.motion.test_motion_query import Array, PointAmongBoxes, across, wall_with_gap

METRIC = JointMetric(np.array([1.0, 0.5]))
PATIENT = RoadmapSettings(neighbours=6, edges=100_000)


@dataclass
class Plane:
    """Postures of a kind: all that are less than `half` from a line; drawn are those of a list."""

    postures: Array
    half: float = np.inf

    def drawn(self, start: Array, goals: Array, rng: np.random.Generator) -> Array:
        return self.postures

    def fits(self, Q: Array) -> np.ndarray:
        return np.abs(Q[:, 0] - Q[:, 1]) < self.half


def scattered(seed: int) -> tuple[Array, Array, Array, PointAmongBoxes]:
    """Return a start, goals, postures and boxes, of which some are in the way."""
    rng = np.random.default_rng(seed)
    start, goals, postures = (rng.uniform(-1.0, 1.0, shape) for shape in ((2,), (3, 2), (40, 2)))
    low = rng.uniform(-1.0, 1.0, (8, 2))
    return start, goals, postures, PointAmongBoxes(low, low + rng.uniform(0.05, 0.5, low.shape))


@pytest.mark.parametrize("half", [np.inf, 1.2])
@pytest.mark.parametrize("seed", range(40))
def test_the_way_is_the_shortest_along_free_edges_between_near_postures(seed: int, half: float) -> None:
    start, goals, postures, boxes = scattered(seed)
    source = Plane(postures, half)
    way = find_way(start, goals, source, boxes, METRIC, PATIENT, np.random.default_rng(0))
    nodes = np.vstack([start, goals, postures])
    graph = nx.Graph()
    graph.add_nodes_from(range(len(nodes)))
    for i, node in enumerate(nodes):
        for j in np.argsort(METRIC.distances(node, nodes))[: PATIENT.neighbours + 1]:
            within = node + np.array([[0.25], [0.5], [0.75]]) * (nodes[j] - node)
            if i != j and source.fits(within).all() and boxes.edge_free(node, nodes[j]):
                graph.add_edge(i, int(j), weight=METRIC.distances(node, nodes[j][None])[0])
    lengths = nx.single_source_dijkstra_path_length(graph, 0)
    known = [lengths[goal] for goal in range(1, 1 + len(goals)) if goal in lengths]
    if not known:
        assert way.path is None
        return
    assert way.path is not None
    assert METRIC.length(way.path) == pytest.approx(min(known), abs=1e-9)
    assert np.array_equal(way.path[0], start)
    assert np.array_equal(way.path[-1], goals[way.goal_index])
    assert all(boxes.edge_free(a, b) for a, b in zip(way.path, way.path[1:], strict=False))


def test_all_kinds_of_answers_are_met() -> None:
    ways = [
        find_way(*scattered(seed)[:2], Plane(scattered(seed)[2]), scattered(seed)[3], METRIC, PATIENT,
                 np.random.default_rng(0))
        for seed in range(40)
    ]  # fmt: skip
    lengths = {0 if way.path is None else len(way.path) for way in ways}
    assert {0, 2, 3, 4} <= lengths


def test_no_more_edges_are_asked_than_allowed() -> None:
    for seed in range(10):
        start, goals, postures, boxes = scattered(seed)
        few = RoadmapSettings(edges=3)
        way = find_way(start, goals, Plane(postures), boxes, METRIC, few, np.random.default_rng(0))
        assert len(boxes.edges_asked) == way.edges_checked <= few.edges


def test_as_many_edges_as_a_way_took_are_enough_for_it() -> None:
    for seed in range(10):
        start, goals, postures, boxes = scattered(seed)
        way = find_way(start, goals, Plane(postures), boxes, METRIC, PATIENT, np.random.default_rng(0))
        enough = RoadmapSettings(PATIENT.neighbours, way.edges_checked)
        again = find_way(start, goals, Plane(postures), boxes, METRIC, enough, np.random.default_rng(0))
        assert again.edges_checked == way.edges_checked
        assert (again.path is None) == (way.path is None)


def test_a_query_that_trees_do_not_solve_is_solved_through_the_postures_of_its_source() -> None:
    wall = wall_with_gap(2, 0.02)
    few = MotionSettings(max_iterations=3)
    query = across(wall, 2)
    assert plan_motion(query, few, np.random.default_rng(0)).outcome is MotionOutcome.ITERATIONS_EXHAUSTED
    above = np.array([[-1.0, 2.99], [1.0, 2.99]])
    sourced = MotionQuery(query.start, query.goals, query.position_min, query.position_max, wall, source=Plane(above))
    found = plan_motion(sourced, few, np.random.default_rng(0))
    assert found.outcome is MotionOutcome.FOUND
    assert found.path is not None
    assert wall.path_free(found.path)
