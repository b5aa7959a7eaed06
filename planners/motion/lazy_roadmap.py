"""Ways through postures that are drawn where few are: a roadmap whose edges are checked where a way would lead.

Where a load must stay level, nearly no posture that is drawn at random is one of those, and trees hardly grow. Whoever
knows what such postures look like draws them, and they are joined here.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import KDTree

from planners.motion.checker import EdgeChecker
from planners.motion.joint_metric import JointMetric

_WITHIN = (0.25, 0.5, 0.75)
"""Parts of an edge at which it is asked first whether postures there are of the kind."""

_NO_LENGTH = 1e-12
"""Stands for 0, which SciPy takes for no edge."""


class PostureSource(Protocol):
    """Knows the postures of a kind of which nearly none is met at random."""

    def drawn(
        self, start: NDArray[np.float64], goals: NDArray[np.float64], rng: np.random.Generator
    ) -> NDArray[np.float64]:
        """Return postures (m, n) within the joints' ranges, between a start (n,) and goals (k, n) [rad]."""
        ...

    def fits(self, Q: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Say (m,) which of Q (m, n) [rad] are of the kind, without asking what they touch."""
        ...


@dataclass(frozen=True)
class RoadmapSettings:
    """How much a roadmap may do."""

    neighbours: int = 12
    """Nearest postures that each is joined to."""
    edges: int = 60
    """That are checked before it is given up."""


@dataclass(frozen=True, eq=False)
class Way:
    """What came of a roadmap; `path` (m, n) [rad] leads from the start to `goals[goal_index]`, both exactly."""

    path: NDArray[np.float64] | None
    goal_index: int
    edges_checked: int


def find_way(
    start: NDArray[np.float64],
    goals: NDArray[np.float64],
    source: PostureSource,
    checker: EdgeChecker,
    metric: JointMetric,
    settings: RoadmapSettings,
    rng: np.random.Generator,
) -> Way:
    """Find the shortest way from the start to any goal along edges between near postures.

    Bohlin and Kavraki, "Path planning using lazy PRM", ICRA 2000: the shortest way is looked for as if all edges were
    free, and checked; an edge that is not free is taken out, and so on.

    Args:
        start: (n,) [rad].
        goals: (k, n) [rad].
        source: of postures that a way may lead through; whether they are free is found out with their edges.
        checker: of edges.
        metric: of ways.
        settings: how much may be done.
        rng: of what is drawn.
    """
    nodes = np.vstack([start, goals, source.drawn(start, goals, rng)])
    edges, lengths = _near(nodes * metric.weights, settings.neighbours)
    fits = np.logical_and.reduce(
        [source.fits(nodes[edges[:, 0]] + part * (nodes[edges[:, 1]] - nodes[edges[:, 0]])) for part in _WITHIN]
    )
    edges, lengths = edges[fits], lengths[fits]
    graph, places = _joined(edges, lengths, len(nodes))
    free = np.zeros(len(edges), dtype=bool)
    for checked in range(settings.edges + 1):
        way = _shortest(graph, len(goals))
        if not len(way):
            return Way(None, -1, checked)
        along = _numbers(edges, way)
        unsure = along[~free[along]]
        if not len(unsure):
            return Way(nodes[way], int(way[-1]) - 1, checked)
        if checked == settings.edges:
            break
        # Where it leaves and where it arrives there is least room.
        edge = unsure[0] if checked % 2 else unsure[-1]
        free[edge] = checker.edge_free(*nodes[edges[edge]])
        if not free[edge]:
            graph.data[places[edge]] = np.inf
    return Way(None, -1, settings.edges)


def _near(points: NDArray[np.float64], neighbours: int) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Return the edges (e, 2), smaller number first and sorted, between near points (m, n), and their lengths (e,)."""
    # Each is its own nearest.
    among = min(neighbours + 1, len(points))
    _, others = KDTree(points).query(points, k=among)
    ends = np.column_stack([np.repeat(np.arange(len(points)), among), np.ravel(others)])
    edges = np.unique(np.sort(ends, axis=1), axis=0)
    edges = edges[edges[:, 0] != edges[:, 1]]
    return edges, np.linalg.norm(points[edges[:, 1]] - points[edges[:, 0]], axis=1)


def _joined(edges: NDArray[np.int64], lengths: NDArray[np.float64], count: int) -> tuple[csr_array, NDArray[np.int64]]:
    """Return the graph of these edges (e, 2), both ways, and where (e, 2) the lengths of each are in its data."""
    tails, heads = np.concatenate([edges, edges[:, ::-1]]).T
    order = np.lexsort((heads, tails))
    starts = np.searchsorted(tails[order], np.arange(count + 1))
    both = np.maximum(np.concatenate([lengths, lengths]), _NO_LENGTH)
    graph = csr_array((both[order], heads[order], starts), shape=(count, count))
    return graph, np.argsort(order).reshape(2, -1).T


def _shortest(graph: csr_array, goals: int) -> NDArray[np.int64]:
    """Return the nodes of the shortest way from node 0 to any of the `goals` behind it; none if there is no way."""
    far, before = dijkstra(graph, indices=0, return_predecessors=True)
    way = [1 + int(np.argmin(far[1 : 1 + goals]))]
    if not np.isfinite(far[way[0]]):
        return np.empty(0, dtype=np.int64)
    while way[-1] != 0:
        way.append(int(before[way[-1]]))
    return np.array(way[::-1])


def _numbers(edges: NDArray[np.int64], way: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return which edges (of all, sorted) a way leads along."""
    legs = np.sort(np.column_stack([way[:-1], way[1:]]), axis=1)
    factor = int(edges.max()) + 1
    return np.searchsorted(edges @ [factor, 1], legs @ [factor, 1])
