"""Ask whether goals can be come to at all, examining as few nodes as possible."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numba import njit
from numpy.typing import NDArray

from planners.graph.search import DEAD, RESOLUTION, UNKNOWN, GraphPath, Knowledge, StateGraph


def passable_path(
    graph: StateGraph,
    knowledge: Knowledge,
    starts: Sequence[int],
    goal: NDArray[np.bool_],
    examine: Callable[[int], None],
) -> GraphPath | None:
    """Find any path of nodes that are alive from a start to a goal, or None if there is none.

    A cheapest path takes the examination of every node that might be on a cheaper one. Here a path with fewest unknown
    nodes is taken and examined, until one holds: to find that there is none, it is enough to examine a cut.

    Args:
        graph: what is searched.
        knowledge: of the graph; it grows.
        starts: nodes to begin at.
        goal: (N,) read anew after every examination, which may take goals away.
        examine: makes an unknown node ALIVE or DEAD, as for `cheapest_path`.
    """
    while True:
        begun = np.array([node for node in starts if knowledge.status[node] != DEAD], dtype=np.int64)
        arc_to = np.full(graph.node_count, -1, np.int64)
        tail_of = np.full(graph.node_count, -1, np.int64)
        node = _nearest_goal(graph, knowledge, begun, goal, arc_to, tail_of)
        if node < 0:
            return None
        nodes, arcs = [int(node)], []
        while arc_to[nodes[-1]] >= 0:
            arcs.append(int(arc_to[nodes[-1]]))
            nodes.append(int(tail_of[nodes[-1]]))
        unknown = [node for node in reversed(nodes) if knowledge.status[node] == UNKNOWN]
        for node in unknown:
            # The examination of one node may prove that others are dead.
            if knowledge.status[node] == UNKNOWN:
                examine(node)
        # An examination may also have taken the goal away.
        if not unknown and goal[nodes[0]]:
            cost = float(graph.cost[arcs].sum()) * RESOLUTION
            return GraphPath(tuple(reversed(nodes)), tuple(int(graph.edge[arc]) for arc in reversed(arcs)), cost)


@njit(cache=True, nogil=True)
def connected_to(graph, knowledge, start):
    """Return which nodes (N,) are joined to one that is not dead, over nodes and edges that are not."""
    head, row_start, edge = graph.head, graph.row_start, graph.edge
    status, edge_dead = knowledge.status, knowledge.edge_dead
    joined = np.zeros(status.shape[0], np.bool_)
    waiting = np.empty(status.shape[0], np.int64)
    waiting[0], count = start, 1
    joined[start] = True
    while count > 0:
        count -= 1
        node = waiting[count]
        for a in range(row_start[node], row_start[node + 1]):
            other = head[a]
            if not joined[other] and not edge_dead[edge[a]] and status[other] != 2:
                joined[other] = True
                waiting[count] = other
                count += 1
    return joined


@njit(cache=True, nogil=True)
def _nearest_goal(graph, knowledge, starts, goal, arc_to, tail_of):
    """Return the goal with fewest unknown nodes on the way, or -1; write by which arc and from where nodes are reached.

    Nodes are taken level by level: of as many unknown nodes first all that lead over no more of them.
    """
    head, row_start, edge = graph.head, graph.row_start, graph.edge
    status, edge_dead = knowledge.status, knowledge.edge_dead
    count = len(head) + len(starts)
    level, beyond = np.empty((count, 3), np.int64), np.empty((count, 3), np.int64)  # node, tail, arc
    settled = np.zeros(status.shape[0], np.bool_)
    waiting, later = 0, 0
    for start in starts:
        level[waiting, 0], level[waiting, 1], level[waiting, 2] = start, -1, -1
        waiting += 1
    while waiting > 0:
        later = 0
        first = 0
        while first < waiting:
            node, tail, arc = level[first, 0], level[first, 1], level[first, 2]
            first += 1
            if settled[node]:
                continue
            settled[node] = True
            tail_of[node], arc_to[node] = tail, arc
            if goal[node]:
                return node
            for a in range(row_start[node], row_start[node + 1]):
                other = head[a]
                if settled[other] or edge_dead[edge[a]] or status[other] == 2:
                    continue
                if status[other] == 1:
                    level[waiting, 0], level[waiting, 1], level[waiting, 2] = other, node, a
                    waiting += 1
                else:
                    beyond[later, 0], beyond[later, 1], beyond[later, 2] = other, node, a
                    later += 1
        level, beyond = beyond, level
        waiting = later
    return -1
