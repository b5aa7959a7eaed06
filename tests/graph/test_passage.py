"""Any way to a goal, against networkx."""

from __future__ import annotations

import itertools

import networkx as nx
import numpy as np
import pytest

from planners.graph.passage import connected_to, passable_path
from planners.graph.search import ALIVE, DEAD, Knowledge, StateGraph, graph_from_edges


class Maze:
    """A random graph of which some nodes and edges are dead, with two starts."""

    def __init__(self, seed: int, nodes: int = 40, edges: int = 70) -> None:
        rng = np.random.default_rng(seed)
        pairs = {tuple(sorted(pair)) for pair in rng.integers(0, nodes, (edges, 2)) if pair[0] != pair[1]}
        self.ends = np.array(sorted(pairs), np.int32)
        count = len(self.ends)
        self.graph: StateGraph = graph_from_edges(
            nodes, self.ends[:, 0], self.ends[:, 1], np.ones((count, 2)), np.zeros(count, bool), np.zeros(count)
        )
        self.alive = rng.random(nodes) < 0.75
        self.starts, self.goal = (0, 1), rng.random(nodes) < 0.08
        self.goal[list(self.starts)] = False
        self.knowledge = Knowledge.none(self.graph)
        self.knowledge.edge_dead[:] = rng.random(count) < 0.15
        self.examined: list[int] = []

    def examine(self, node: int) -> None:
        self.examined.append(node)
        self.knowledge.status[node] = ALIVE if self.alive[node] else DEAD

    def reference(self) -> nx.Graph:
        """Only what is alive."""
        graph = nx.Graph()
        graph.add_nodes_from(np.flatnonzero(self.alive).tolist())
        left = zip(self.ends.tolist(), self.knowledge.edge_dead, strict=True)
        graph.add_edges_from((a, b) for (a, b), dead in left if not dead and self.alive[a] and self.alive[b])
        return graph


@pytest.mark.parametrize("seed", range(60))
def test_a_way_is_found_if_and_only_if_there_is_one(seed: int) -> None:
    maze = Maze(seed)
    path = passable_path(maze.graph, maze.knowledge, maze.starts, maze.goal, maze.examine)
    reference = maze.reference()
    goals = np.flatnonzero(maze.goal & maze.alive).tolist()
    open_starts = [start for start in maze.starts if maze.alive[start]]
    assert (path is not None) == any(nx.has_path(reference, a, b) for a in open_starts for b in goals)
    if path is not None:
        assert path.nodes[0] in maze.starts
        assert maze.goal[path.nodes[-1]]
        for edge, step in zip(path.edges, itertools.pairwise(path.nodes), strict=True):
            assert set(step) == set(maze.ends[edge].tolist())
            assert reference.has_edge(*step)


@pytest.mark.parametrize("seed", range(20))
def test_what_is_joined_to_a_node_is_its_component(seed: int) -> None:
    maze = Maze(seed)
    for node in range(maze.graph.node_count):
        maze.examine(node)
    reference = maze.reference()
    for start in np.flatnonzero(maze.alive).tolist():
        joined = connected_to(maze.graph, maze.knowledge, start)
        assert set(np.flatnonzero(joined).tolist()) == nx.node_connected_component(reference, start)


def test_a_cut_is_all_that_is_examined_where_there_is_no_way() -> None:
    """The one node that leads on is dead; of all else that lies next to the start nothing has to be looked at."""
    row = [(node, node + 1) for node in range(1, 30)]
    fan = [(0, node) for node in range(31, 60)]
    ends = np.array([(0, 1), *row, *fan], np.int32)
    count = len(ends)
    graph = graph_from_edges(60, ends[:, 0], ends[:, 1], np.ones((count, 2)), np.zeros(count, bool), np.zeros(count))
    knowledge, goal = Knowledge.none(graph), np.zeros(60, bool)
    goal[30] = True
    examined: list[int] = []

    def examine(node: int) -> None:
        examined.append(node)
        knowledge.status[node] = DEAD if node == 1 else ALIVE

    assert passable_path(graph, knowledge, (0,), goal, examine) is None
    assert not set(examined) & set(range(31, 60))


def test_a_goal_that_an_examination_takes_away_is_none() -> None:
    ends = np.array([(0, 1), (0, 2)], np.int32)
    graph = graph_from_edges(3, ends[:, 0], ends[:, 1], np.ones((2, 2)), np.zeros(2, bool), np.zeros(2))
    knowledge, goal = Knowledge.none(graph), np.array([False, True, True])

    def examine(node: int) -> None:
        knowledge.status[node] = ALIVE
        goal[1] = False

    path = passable_path(graph, knowledge, (0,), goal, examine)
    assert path is not None
    assert path.nodes == (0, 2)
