"""The lazy search against networkx, and against itself when everything was examined beforehand."""

from __future__ import annotations

import networkx as nx
import numpy as np
import pytest

from planners.graph.search import (
    ALIVE,
    DEAD,
    FAR,
    RESOLUTION,
    GoalSearch,
    Knowledge,
    cheapest_path,
    costs_to_go,
    graph_from_edges,
    whole,
)


class RandomCase:
    """A random graph with loads, some dead nodes and one start."""

    def __init__(self, seed: int, nodes: int = 60, edges: int = 240) -> None:
        rng = np.random.default_rng(seed)
        pairs = {tuple(sorted(pair)) for pair in rng.integers(0, nodes, (edges, 2)) if pair[0] != pair[1]}
        ends = np.array(sorted(pairs), np.int32)
        self.tail, self.head = ends[:, 0], ends[:, 1]
        self.costs = rng.choice([0.05, 0.2, 1.0, 2.5], (len(ends), 2))
        self.loaded = rng.random(len(ends)) < 0.4
        self.effort = rng.random(len(ends))
        self.load = np.rint(rng.random(nodes) * 5e6) * 1e-6
        self.alive = rng.random(nodes) < 0.8
        self.alive[0] = True
        self.goal = rng.random(nodes) < 0.1
        self.goal[0] = False
        self.graph = graph_from_edges(nodes, self.tail, self.head, self.costs, self.loaded, self.effort)
        self.examined: list[int] = []

    def search(self, *, lazy: bool, bottleneck: bool = False, killed: tuple[int, ...] = ()):
        """Search from node 0; examine nodes on demand, or all of them beforehand."""
        self.knowledge = Knowledge.none(self.graph)
        self.knowledge.edge_dead[list(killed)] = True
        self.examined.clear()
        if not lazy:
            for node in range(self.graph.node_count):
                self.examine(node)
        heuristic = np.zeros(self.graph.node_count, np.int64)
        return cheapest_path(self.graph, self.knowledge, 0, self.goal, heuristic, self.examine, bottleneck=bottleneck)

    def examine(self, node: int) -> None:
        self.examined.append(node)
        self.knowledge.status[node] = ALIVE if self.alive[node] else DEAD
        self.knowledge.load[node] = whole(self.load[node])

    def reference(self, killed: tuple[int, ...] = ()) -> nx.DiGraph:
        """The same graph, dead nodes and edges left out, every arc with its full cost."""
        result = nx.DiGraph()
        result.add_node(0)
        for k, (a, b) in enumerate(zip(self.tail, self.head, strict=True)):
            if self.alive[a] and self.alive[b] and k not in killed:
                extra = self.load[a] + self.load[b] if self.loaded[k] else 0.0
                result.add_edge(int(a), int(b), weight=self.costs[k, 0] + extra)
                result.add_edge(int(b), int(a), weight=self.costs[k, 1] + extra)
        return result


def cheapest_goal(case: RandomCase, killed: tuple[int, ...] = ()) -> float | None:
    distances = nx.single_source_dijkstra_path_length(case.reference(killed), 0)
    return min((d for node, d in distances.items() if case.goal[node]), default=None)


@pytest.mark.parametrize("seed", range(40))
def test_lazy_search_pays_what_dijkstra_on_the_examined_graph_pays(seed):
    case = RandomCase(seed)
    path, expected = case.search(lazy=True), cheapest_goal(case)
    if expected is None:
        assert path is None
        return
    assert path is not None
    assert path.cost == pytest.approx(expected, abs=100 * RESOLUTION)
    assert path.nodes[0] == 0
    assert case.goal[path.nodes[-1]]


@pytest.mark.parametrize("seed", range(40))
def test_lazy_and_full_search_return_the_same_path(seed):
    case = RandomCase(seed)
    lazy, full = case.search(lazy=True), case.search(lazy=False)
    assert (lazy and lazy.nodes) == (full and full.nodes)


def test_lazy_search_leaves_nodes_unexamined():
    counts = []
    for seed in range(20):
        case = RandomCase(seed)
        case.search(lazy=True)
        counts.append(len(case.examined))
    assert min(counts) < 60
    assert len(set(case.examined)) == len(case.examined)


@pytest.mark.parametrize("seed", range(20))
def test_a_dead_edge_is_never_used_again(seed):
    case = RandomCase(seed)
    killed: tuple[int, ...] = ()
    while (path := case.search(lazy=True, killed=killed)) is not None:
        assert not set(path.edges) & set(killed)
        assert path.cost == pytest.approx(cheapest_goal(case, killed), abs=100 * RESOLUTION)
        killed = (*killed, path.edges[len(path.edges) // 2])
    assert cheapest_goal(case, killed) is None


@pytest.mark.parametrize("seed", range(40))
def test_bottleneck_search_minimises_the_largest_load(seed):
    """Oracle: the smallest threshold at which a goal is still connected."""
    case = RandomCase(seed)
    path = case.search(lazy=True, bottleneck=True)
    thresholds = sorted({float(load) for load in case.load})
    reference = case.reference()
    for limit in thresholds:
        part = reference.subgraph([n for n in reference if case.load[n] <= limit + 1e-12])
        if 0 in part and any(case.goal[n] for n in nx.descendants(part, 0)):
            assert path is not None
            assert max(case.load[n] for n in path.nodes) == pytest.approx(limit)
            return
    assert path is None


@pytest.mark.parametrize("seed", range(40))
def test_costs_to_go_are_what_dijkstra_pays_backward(seed):
    case = RandomCase(seed)
    case.search(lazy=False)
    to_go = costs_to_go(case.graph, case.knowledge, case.goal)
    reference = case.reference().reverse()
    goals = [node for node in reference if case.goal[node] and case.alive[node]]
    paid = nx.multi_source_dijkstra_path_length(reference, goals) if goals else {}
    for node in range(case.graph.node_count):
        if node in paid:
            assert to_go[node] * RESOLUTION == pytest.approx(paid[node], abs=100 * RESOLUTION)
        else:
            assert to_go[node] == FAR


@pytest.mark.parametrize("seed", range(40))
def test_a_search_with_costs_to_go_finds_the_same_paths_while_ever_more_falls(seed):
    """Oracle: an A* without any heuristic that knows nothing beforehand."""
    case, rng = RandomCase(seed), np.random.default_rng(seed)
    knowledge, killed = Knowledge.none(case.graph), ()

    def examine(node: int) -> None:
        knowledge.status[node] = ALIVE if case.alive[node] else DEAD
        knowledge.load[node] = whole(case.load[node])

    search = GoalSearch(case.graph, knowledge, case.goal, examine)
    for _ in range(30):
        path, expected = search.path_from(0), case.search(lazy=True, killed=killed)
        assert (path and (path.nodes, path.edges)) == (expected and (expected.nodes, expected.edges))
        if path is None:
            return
        killed = (*killed, path.edges[int(rng.integers(len(path.edges)))])
        knowledge.edge_dead[list(killed)] = True


@pytest.mark.parametrize("seed", range(10))
def test_arcs_stand_by_the_nodes_that_they_leave_and_then_by_where_they_lead(seed):
    """Oracle: NumPy's sort of all arcs; some edges join the same two nodes."""
    rng = np.random.default_rng(seed)
    ends = rng.integers(0, 20, (150, 2)).astype(np.int32)
    ends = ends[ends[:, 0] != ends[:, 1]]
    costs, effort, loaded = rng.random((len(ends), 2)), rng.random(len(ends)), rng.random(len(ends)) < 0.5
    graph = graph_from_edges(20, ends[:, 0], ends[:, 1], costs, loaded, effort)
    tails, heads = np.concatenate([ends, ends[:, ::-1]]).T
    order = np.lexsort((heads, tails))
    assert np.array_equal(graph.head, heads[order])
    assert np.array_equal(graph.row_start, np.searchsorted(tails[order], np.arange(21)))
    assert np.array_equal(graph.edge, order % len(ends))
    both = np.concatenate([costs[:, 0], costs[:, 1]]), np.concatenate([costs[:, 1], costs[:, 0]])
    for told, wanted in zip((graph.cost, graph.cost_back), both, strict=True):
        assert np.array_equal(told, whole(wanted)[order])
    assert np.array_equal(graph.effort, whole(effort)[graph.edge])
    assert np.array_equal(graph.loaded, loaded[graph.edge])
