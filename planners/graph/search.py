"""Cheapest paths through a graph whose nodes are examined only when the search reaches them.

Most nodes of a manipulation graph are never on a cheap path, and to examine one costs a cone program. So the
search is an A* in which a node starts as *unknown*, with a lower bound of its load, and is examined when it is
first taken from the queue. Whether all nodes are examined beforehand or on demand, the path is the same: costs
are whole numbers (exactly additive in any order), and equal costs are decided by a second cost, then by node.

A graph is searched many times, from each start and after every failure. The cost to go, from each node to the nearest
goal, is computed backward, once for all starts, from what is known then (`GoalSearch`): what becomes known later, loads
and failures, only makes it larger, so that it stays a lower bound, and an A* with it goes straight where nothing has
changed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

RESOLUTION = 1e-9
"""Costs are counted in whole multiples of this, so that sums do not depend on their order."""

UNKNOWN, ALIVE, DEAD = 0, 1, 2
_FOUND = -1


class StateGraph(NamedTuple):
    """A directed graph in compressed rows; an arc costs its own cost plus, if it is loaded, both its ends' loads.

    Loads stand for what depends on a node alone (in paper B, the joint torque of eq. (10)).
    """

    row_start: NDArray[np.int64]
    """(N + 1,) arcs of node n are `row_start[n]` up to `row_start[n + 1]`."""
    head: NDArray[np.int32]
    """(A,) the node each arc leads to."""
    cost: NDArray[np.int64]
    """(A,) in multiples of RESOLUTION, without loads."""
    loaded: NDArray[np.bool_]
    """(A,) whether the loads of both ends are added."""
    effort: NDArray[np.int64]
    """(A,) second cost, which decides between equally cheap paths."""
    edge: NDArray[np.int32]
    """(A,) number of the undirected edge that the arc belongs to."""
    cost_back: NDArray[np.int64]
    """(A,) cost of the arc the other way."""

    @property
    def node_count(self) -> int:
        """Number of nodes."""
        return len(self.row_start) - 1

    @property
    def edge_count(self) -> int:
        """Number of undirected edges."""
        return int(self.edge.max()) + 1 if len(self.edge) else 0


class Knowledge(NamedTuple):
    """What is known of a graph so far: it only ever grows, and is shared by all searches of the graph."""

    status: NDArray[np.int8]
    """(N,) UNKNOWN, ALIVE or DEAD."""
    load: NDArray[np.int64]
    """(N,) a lower bound while unknown, the load once alive; multiples of RESOLUTION."""
    edge_dead: NDArray[np.bool_]
    """(E,) edges that were tried and failed."""

    @classmethod
    def none(cls, graph: StateGraph) -> Knowledge:
        """Know nothing of `graph`: all nodes unknown with load 0, no edge dead."""
        return cls(
            np.zeros(graph.node_count, np.int8),
            np.zeros(graph.node_count, np.int64),
            np.zeros(graph.edge_count, np.bool_),
        )


@dataclass(frozen=True)
class GraphPath:
    """A cheapest path: its nodes and edges, and its cost."""

    nodes: tuple[int, ...]
    edges: tuple[int, ...]
    cost: float


def graph_from_edges(
    node_count: int,
    tail: NDArray[np.int32],
    head: NDArray[np.int32],
    costs: NDArray[np.float64],
    loaded: NDArray[np.bool_],
    effort: NDArray[np.float64],
) -> StateGraph:
    """Build a graph from E undirected edges; `costs` is (E, 2): from tail to head, and back."""
    both, second = whole(costs), whole(effort)
    row_start, arc = _rows(node_count, np.asarray(tail, np.int32), np.asarray(head, np.int32))
    # Arc k < E leads from the tail of edge k to its head, arc E + k back.
    edge = np.where(arc < len(tail), arc, arc - len(tail)).astype(np.int32)
    back = arc >= len(tail)
    return StateGraph(
        row_start,
        np.where(back, tail[edge], head[edge]).astype(np.int32),
        np.where(back, both[edge, 1], both[edge, 0]),
        loaded[edge],
        second[edge],
        edge,
        np.where(back, both[edge, 0], both[edge, 1]),
    )


@njit(cache=True, nogil=True)
def _rows(node_count, tail, head):
    """Return the arcs (2 E,) of undirected edges ordered by the node that they leave, then by where they lead.

    Args:
        node_count: N.
        tail: (E,) of the arcs 0 to E - 1.
        head: (E,) likewise; the arcs E to 2 E - 1 lead back.

    Returns:
        (N + 1,) where each node's arcs begin, and the arcs.
    """
    count = len(tail)
    row_start = np.zeros(node_count + 1, np.int64)
    for k in range(count):
        row_start[tail[k] + 1] += 1
        row_start[head[k] + 1] += 1
    for node in range(node_count):
        row_start[node + 1] += row_start[node]
    # As many arcs lead to a node as leave it, so that both passes of this counting sort begin at the same places. What
    # the first puts one after the other, the second keeps so.
    by_head, by_tail = np.empty(2 * count, np.int32), np.empty(2 * count, np.int32)
    place = row_start[:-1].copy()
    for k in range(count):
        by_head[place[head[k]]] = k
        place[head[k]] += 1
    for k in range(count):
        by_head[place[tail[k]]] = count + k
        place[tail[k]] += 1
    place[:] = row_start[:-1]
    for arc in by_head:
        node = tail[arc] if arc < count else head[arc - count]
        by_tail[place[node]] = arc
        place[node] += 1
    return row_start, by_tail


def whole(cost: NDArray[np.float64] | float) -> NDArray[np.int64]:
    """Express costs as whole multiples of RESOLUTION."""
    return np.rint(np.asarray(cost) / RESOLUTION).astype(np.int64)


def cheapest_path(
    graph: StateGraph,
    knowledge: Knowledge,
    start: int,
    goal: NDArray[np.bool_],
    heuristic: NDArray[np.int64],
    examine: Callable[[int], None],
    *,
    bottleneck: bool = False,
) -> GraphPath | None:
    """Find the cheapest path from `start` to any node of `goal`, or None if there is none.

    `examine(node)` must make an unknown node ALIVE with its exact load, or DEAD, in `knowledge`. `heuristic` is a
    consistent lower bound of the remaining cost. With `bottleneck` the path with the smallest largest load is
    sought instead; among such paths arc costs only steer, and their sum need not be the least.
    """
    state = _SearchState.begun(graph, start, heuristic)
    return state.finished(graph, knowledge, goal, heuristic, examine, bottleneck=bottleneck)


class GoalSearch:
    """Searches one graph for the cheapest paths to its goals, again and again while ever more of it is known.

    The heuristic is the cost to go of each node, as it was when last computed. It is computed again as soon as searches
    have expanded as many nodes since as the graph has, so that it takes no more time than they do.
    """

    def __init__(
        self,
        graph: StateGraph,
        knowledge: Knowledge,
        goal: NDArray[np.bool_],
        examine: Callable[[int], None],
        *,
        bottleneck: bool = False,
    ) -> None:
        """Prepare.

        Args:
            graph: what is searched.
            knowledge: of the graph; it grows.
            goal: (N,) goals, of which some may be taken away meanwhile.
            examine: as for `cheapest_path`.
            bottleneck: likewise; costs to go are of no use then.
        """
        self._graph, self._knowledge, self._goal = graph, knowledge, goal
        self._examine, self._bottleneck = examine, bottleneck
        self._to_go = np.zeros(graph.node_count, np.int64) if bottleneck else None
        self._expanded = 0

    def path_from(self, start: int) -> GraphPath | None:
        """Return the cheapest path from a start to any goal; None if there is none."""
        if not self._bottleneck and (self._to_go is None or self._expanded > self._graph.node_count):
            self._to_go, self._expanded = costs_to_go(self._graph, self._knowledge, self._goal), 0
        assert self._to_go is not None
        state = _SearchState.begun(self._graph, start, self._to_go)
        path = state.finished(
            self._graph, self._knowledge, self._goal, self._to_go, self._examine, bottleneck=self._bottleneck
        )
        self._expanded += state.expanded
        return path


FAR = np.int64(1) << 60
"""Stands for the cost to go where no goal can be come to: those nodes are taken last."""


@njit(cache=True, nogil=True)
def costs_to_go(graph, knowledge, goal):
    """Return the cost to go from each node to the nearest goal (N,), were all unknown nodes alive, loaded least.

    Nodes that cannot come to a goal have `FAR`, and so have dead ones.
    """
    head, row_start, edge, loaded, back = graph.head, graph.row_start, graph.edge, graph.loaded, graph.cost_back
    status, load, edge_dead = knowledge.status, knowledge.load, knowledge.edge_dead
    count = status.shape[0]
    to_go = np.full(count, FAR)
    queue_cost, queue_node = np.empty(len(head) + count, np.int64), np.empty(len(head) + count, np.int32)
    length = 0
    for node in range(count):
        if goal[node] and status[node] != 2:
            # All cost nothing: in any order they are a heap.
            to_go[node] = 0
            queue_cost[length], queue_node[length] = 0, node
            length += 1
    while length > 0:
        cost, node = queue_cost[0], queue_node[0]
        length -= 1
        last_cost, last_node = queue_cost[length], queue_node[length]
        i = 0
        while True:
            child = 2 * i + 1
            if child >= length:
                break
            if child + 1 < length and queue_cost[child + 1] < queue_cost[child]:
                child += 1
            if queue_cost[child] >= last_cost:
                break
            queue_cost[i], queue_node[i] = queue_cost[child], queue_node[child]
            i = child
        queue_cost[i], queue_node[i] = last_cost, last_node
        if cost > to_go[node]:
            continue
        for a in range(row_start[node], row_start[node + 1]):
            other = head[a]
            if edge_dead[edge[a]] or status[other] == 2:
                continue
            reached = cost + back[a]
            if loaded[a]:
                reached += load[node] + load[other]
            if reached >= to_go[other]:
                continue
            to_go[other] = reached
            i = length
            length += 1
            while i > 0:
                above = (i - 1) // 2
                if queue_cost[above] <= reached:
                    break
                queue_cost[i], queue_node[i] = queue_cost[above], queue_node[above]
                i = above
            queue_cost[i], queue_node[i] = reached, other
    return to_go


class _SearchState(NamedTuple):
    """The queue and the tree of one search, kept between the calls of the compiled part."""

    keys: NDArray[np.int64]
    """(capacity, 4) of the queue: f, effort, g, load counted so far."""
    links: NDArray[np.int32]
    """(capacity, 3) likewise: node, parent, arc."""
    counters: NDArray[np.int64]
    """(3,) queue length, expanded nodes, goal reached."""
    offered: NDArray[np.int64]
    """(N, 3) least cost, effort and parent queued."""
    best: NDArray[np.int64]
    """(N, 2) settled cost and effort."""
    parent: NDArray[np.int32]
    """(N, 2) settled parent and arc."""

    @classmethod
    def begun(cls, graph: StateGraph, start: int, heuristic: NDArray[np.int64]) -> _SearchState:
        """Begin with one node in the queue."""
        # Every arc enters the queue once when its tail is settled and once more when its head turns out to be
        # loaded; every node waits once for its examination.
        capacity = 2 * len(graph.head) + graph.node_count + 2
        state = cls(
            np.empty((capacity, 4), np.int64),
            np.empty((capacity, 3), np.int32),
            np.array([1, 0, 0], np.int64),
            np.full((graph.node_count, 3), np.iinfo(np.int64).max),
            np.full((graph.node_count, 2), -1, np.int64),
            np.full((graph.node_count, 2), -1, np.int32),
        )
        state.keys[0] = (heuristic[start], 0, 0, 0)
        state.links[0] = (start, -1, -1)
        return state

    def finished(
        self,
        graph: StateGraph,
        knowledge: Knowledge,
        goal: NDArray[np.bool_],
        heuristic: NDArray[np.int64],
        examine: Callable[[int], None],
        *,
        bottleneck: bool,
    ) -> GraphPath | None:
        """Search to the end; see `cheapest_path`."""
        while (node := _advance(graph, knowledge, goal, heuristic, bottleneck, self)) >= 0:
            examine(int(node))
        return self.path(graph) if node == _FOUND else None

    @property
    def expanded(self) -> int:
        """How many nodes were."""
        return int(self.counters[1])

    def path(self, graph: StateGraph) -> GraphPath:
        """Walk back from the goal that was reached."""
        node = int(self.counters[2])
        cost = float(self.best[node, 0]) * RESOLUTION
        nodes, edges = [node], []
        while self.parent[node, 0] >= 0:
            edges.append(int(graph.edge[self.parent[node, 1]]))
            node = int(self.parent[node, 0])
            nodes.append(node)
        return GraphPath(tuple(reversed(nodes)), tuple(reversed(edges)), cost)


@njit(cache=True, nogil=True)
def _before(keys, links, i, j):
    """Whether queue entry i is to be taken before entry j: by f, then effort, then node, then parent."""
    for k in range(2):
        if keys[i, k] != keys[j, k]:
            return keys[i, k] < keys[j, k]
    for k in range(2):
        if links[i, k] != links[j, k]:
            return links[i, k] < links[j, k]
    return False


@njit(cache=True, nogil=True)
def _less(cost, effort, parent, offered):
    """Whether a way to a node comes before the best that is queued: by cost, then effort, then parent."""
    if cost != offered[0]:
        return cost < offered[0]
    if effort != offered[1]:
        return effort < offered[1]
    return parent < offered[2]


@njit(cache=True, nogil=True)
def _swap(keys, links, i, j):
    for k in range(keys.shape[1]):
        keys[i, k], keys[j, k] = keys[j, k], keys[i, k]
    for k in range(links.shape[1]):
        links[i, k], links[j, k] = links[j, k], links[i, k]


@njit(cache=True, nogil=True)
def _push(keys, links, counters, key, link):
    i = counters[0]
    counters[0] += 1
    keys[i, 0], keys[i, 1], keys[i, 2], keys[i, 3] = key
    links[i, 0], links[i, 1], links[i, 2] = link
    while i > 0:
        above = (i - 1) // 2
        if not _before(keys, links, i, above):
            break
        _swap(keys, links, i, above)
        i = above


@njit(cache=True, nogil=True)
def _pop(keys, links, counters):
    """Remove the first entry; it is left just behind the queue's end, at index `counters[0]`."""
    counters[0] -= 1
    length = counters[0]
    _swap(keys, links, 0, length)
    i = 0
    while True:
        child = 2 * i + 1
        if child >= length:
            break
        if child + 1 < length and _before(keys, links, child + 1, child):
            child += 1
        if not _before(keys, links, child, i):
            break
        _swap(keys, links, i, child)
        i = child


@njit(cache=True, nogil=True)
def _advance(graph, knowledge, goal, heuristic, bottleneck, state):
    """Search until a node must be examined (its number is returned), a goal is settled, or nothing is left."""
    row_start, head, cost, loaded, effort, edge, _ = graph
    status, load, edge_dead = knowledge
    keys, links, counters, offered, best, parent = state
    while counters[0] > 0:
        node = links[0, 0]
        if best[node, 0] >= 0 or status[node] == 2:
            _pop(keys, links, counters)
            continue
        if status[node] == 0:
            return node
        _pop(keys, links, counters)
        top = counters[0]
        g, e, counted = keys[top, 2], keys[top, 1], keys[top, 3]
        from_node, arc = links[top, 1], links[top, 2]
        if bottleneck:
            exact = max(g, load[node])
        elif arc >= 0 and loaded[arc]:
            exact = g - counted + load[node]
        else:
            exact = g
        if exact > g:
            key = exact + heuristic[node], e, exact, load[node]
            _push(keys, links, counters, key, (node, from_node, arc))
            continue
        best[node, 0], best[node, 1] = g, e
        parent[node, 0], parent[node, 1] = from_node, arc
        counters[1] += 1
        if goal[node]:
            counters[2] = node
            return -1
        for a in range(row_start[node], row_start[node + 1]):
            other = head[a]
            if edge_dead[edge[a]] or status[other] == 2 or best[other, 0] >= 0:
                continue
            if bottleneck:
                reached = max(g, load[other])
                second = e + cost[a]
            else:
                reached = g + cost[a]
                second = e + effort[a]
                if loaded[a]:
                    reached += load[node] + load[other]
            # What comes later by the order of the queue is never needed, whatever an unknown load turns out to be.
            if not _less(reached, second, node, offered[other]):
                continue
            if status[other] == 1 or not (bottleneck or loaded[a]):
                offered[other, 0], offered[other, 1], offered[other, 2] = reached, second, node
            key = reached + heuristic[other], second, reached, load[other]
            _push(keys, links, counters, key, (other, node, a))
    return -2
