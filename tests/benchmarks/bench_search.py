"""Cheapest paths on a random graph of the size of the paper's largest, beside scipy and networkx."""

from __future__ import annotations

from statistics import median
from time import process_time

import networkx as nx
import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra

from planners.graph.search import ALIVE, RESOLUTION, Knowledge, StateGraph, cheapest_path, graph_from_edges

NODES, EDGES, STARTS, GOALS = 30_000, 300_000, 20, 20
LARGEST_COST = 10.0


def measure() -> dict[str, float]:
    """Return CPU milliseconds per start, and the largest difference between the costs found."""
    rng = np.random.default_rng(0)
    ends = np.unique(np.sort(rng.integers(NODES, size=(EDGES, 2)), axis=1), axis=0)
    ends = ends[ends[:, 0] != ends[:, 1]].astype(np.int32)
    cost = rng.uniform(0.1, LARGEST_COST, len(ends))
    chosen = rng.choice(NODES, STARTS + GOALS, replace=False)
    starts, goals = chosen[:STARTS], chosen[STARTS:]
    ours, ours_ms = _ours(ends, cost, starts, goals)
    scipys, scipy_ms = _scipys(ends, cost, starts, goals)
    theirs, networkx_ms = _networkxs(ends, cost, starts[:2], goals)
    return {
        "ours_ms": ours_ms,
        "scipy_ms": scipy_ms,
        "networkx_ms": networkx_ms,
        "largest_difference": float(max(np.abs(ours - scipys).max(), np.abs(ours[:2] - theirs).max())),
    }


def _ours(ends: np.ndarray, cost: np.ndarray, starts: np.ndarray, goals: np.ndarray) -> tuple[np.ndarray, float]:
    count = len(ends)
    graph = graph_from_edges(
        NODES, ends[:, 0], ends[:, 1], np.column_stack([cost, cost]), np.zeros(count, bool), np.zeros(count)
    )
    goal = np.zeros(NODES, bool)
    goal[goals] = True
    _cost(graph, goal, int(starts[0]))
    return _each_start(lambda start: _cost(graph, goal, start), starts)


def _cost(graph: StateGraph, goal: np.ndarray, start: int) -> float:
    knowledge = Knowledge.none(graph)
    knowledge.status[:] = ALIVE
    path = cheapest_path(graph, knowledge, start, goal, np.zeros(NODES, np.int64), _never)
    return np.inf if path is None else path.cost


def _scipys(ends: np.ndarray, cost: np.ndarray, starts: np.ndarray, goals: np.ndarray) -> tuple[np.ndarray, float]:
    weights = csr_matrix((np.rint(cost / RESOLUTION) * RESOLUTION, ends.T), shape=(NODES, NODES))
    return _each_start(lambda start: dijkstra(weights, directed=False, indices=start)[goals].min(), starts)


def _networkxs(ends: np.ndarray, cost: np.ndarray, starts: np.ndarray, goals: np.ndarray) -> tuple[np.ndarray, float]:
    graph = nx.Graph()
    graph.add_weighted_edges_from((*pair, weight) for pair, weight in zip(ends.tolist(), cost.tolist(), strict=True))
    return _each_start(
        lambda start: min(map(nx.single_source_dijkstra_path_length(graph, start).__getitem__, goals.tolist())), starts
    )


def _each_start(search, starts: np.ndarray) -> tuple[np.ndarray, float]:
    costs, milliseconds = [], []
    for start in starts.tolist():
        begun = process_time()
        costs.append(search(start))
        milliseconds.append(1e3 * (process_time() - begun))
    return np.array(costs), median(milliseconds)


def _never(node: int) -> None:
    raise AssertionError(f"node {node} is known and was examined")
