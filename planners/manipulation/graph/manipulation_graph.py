"""The Manipulation State Graph: every plate pose with every hold that reaches it, merged and weighted.

Paper B, section V. A node is a plate pose of the DCSG with one hold (its contact state is the pose's, its suction
the task's). Two kinds of edges: TRANSFER within the graph of one hold (the DCSG-RV), and TRANSIT between the graphs
of two holds, at one plate pose, where one hold is a subset of the other.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from dataclasses import dataclass, field, replace
from enum import Enum

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from planners.graph.search import ALIVE, DEAD, UNKNOWN, Knowledge, StateGraph, graph_from_edges
from planners.manipulation.contacts.dense_contact_states import DenseContactStateGraph
from planners.manipulation.reach.hand_reach import Hand

AnyNumbers = NDArray[np.int32] | NDArray[np.int64]


@dataclass(frozen=True)
class TransitionCost:
    """The weights of the edge costs. The paper publishes none; 1 for both is our choice."""

    k: float = 1.0
    """Cost of a transfer within one contact state, eq. (6)."""
    omega: float = 1.0
    """Weight of a change of contact state, eq. (9)."""
    load: float = 1.0
    """Weight of a node's load, its part of eq. (10), in a cell of size 1 [1/Nm]."""

    def same_contact(self) -> float:
        """Cost of moving the plate within one contact state with one hold, eq. (6)."""
        return self.k

    def contact_change(self, restraint_before: int, restraint_after: int) -> float:
        """Cost of a change of contact state with one hold, eq. (9): less restraint is cheaper to reach."""
        return self.omega * math.exp(-(restraint_before - restraint_after))


class EdgeKind(Enum):
    """What happens on an edge."""

    TRANSIT = "A hand moves while the plate rests in its pose."
    TRANSFER = "The plate moves while the hold is kept."


@dataclass(frozen=True)
class HandHold:
    """One grip or one push in the list of holds, and which of its postures may be used.

    A posture is one rigid pose of the hand on the plate together with one branch of the arm's inverse kinematics
    (bits of `postures`). All are allowed at first; a hold is split into its postures where a plan needs to know.
    """

    index: int
    """Of the grip or push it is."""
    postures: int
    """Bit set."""


@dataclass(frozen=True, eq=False)
class ManipulationStateGraph:
    """The merged graph. Holds are numbered from 1; 0 means that the hand is absent."""

    poses: DenseContactStateGraph
    grips: tuple[HandHold, ...]
    pushes: tuple[HandHold, ...]
    node_pose: NDArray[np.int32]
    node_grip: NDArray[np.int32]
    node_push: NDArray[np.int32]
    graph: StateGraph
    edge_kind: NDArray[np.bool_]
    """(E,) True for TRANSIT."""
    edge_nodes: NDArray[np.int32]
    """(E, 2)"""
    edge_motion: NDArray[np.int32]
    """(E,) the DCSG edge of a TRANSFER, -1 for a TRANSIT."""
    first_transits: tuple[int, int]
    """The first edge on which the push comes or goes, and the first on which the grip does. Transfers stand before
    them, ordered by motion; each kind of transit is ordered by pose."""
    starts: tuple[int, ...]
    goal: NDArray[np.bool_]
    load_weight: float
    """Of a node's load, see `TransitionCost.load`."""
    knowledge: Knowledge = field(repr=False)
    lost_starts: set[int] = field(default_factory=set)
    """Start nodes that no hand can come to."""

    def kind(self, edge: int) -> EdgeKind:
        """Return what happens on an edge."""
        return EdgeKind.TRANSIT if self.edge_kind[edge] else EdgeKind.TRANSFER

    def transfers(self, motion: int) -> NDArray[np.int64]:
        """Return the edges (n,) on which the plate makes a motion of the DCSG."""
        among = self.edge_motion[: self.first_transits[0]]
        # Numbers of another type would have all of the edges converted.
        return np.arange(*np.searchsorted(among, np.array((motion, motion + 1), among.dtype)))

    def transits(self, pose: int, changing: Hand) -> NDArray[np.int64]:
        """Return the edges (n,) on which a hand comes or goes at a pose, to the second node of each."""
        push, grip = self.first_transits
        among = range(push, grip) if changing == "push" else range(grip, len(self.edge_motion))
        begin, end = (bisect_left(among, at, key=self._pose_of) for at in (pose, pose + 1))
        return np.arange(among.start + begin, among.start + end)

    def _pose_of(self, edge: int) -> int:
        """Return the pose at the first end of an edge."""
        return int(self.node_pose[self.edge_nodes[edge, 0]])

    def unexamined(self) -> ManipulationStateGraph:
        """Return a copy to be examined; call it while nothing is known of this one."""
        return replace(self, goal=self.goal.copy(), knowledge=Knowledge.none(self.graph), lost_starts=set())

    def learn_from(self, other: ManipulationStateGraph, *, goals: bool) -> None:
        """Take over what is known of nodes of another graph of the same poses: of those that have their holds here too.

        Args:
            other: has other holds besides, such as one that is told apart here by its postures.
            goals: whether what is a goal there is one here. If not, they are examined anew, with their loads known.
        """
        holds = ((self.grips, other.grips, self.node_grip), (self.pushes, other.pushes, self.node_push))
        grip, push = (_number_in(its, mine)[of_node] for mine, its, of_node in holds)
        there = other._nodes_at(self.node_pose, grip, push)
        same = np.flatnonzero(there >= 0)
        there = there[same]
        status = other.knowledge.status[there]
        if goals:
            self.goal[same] &= other.goal[there]
        else:
            status = np.where(self.goal[same] & (status == ALIVE), UNKNOWN, status)
        self.knowledge.status[same], self.knowledge.load[same] = status, other.knowledge.load[there]

    def _nodes_at(self, pose: NDArray[np.int32], grip: NDArray[np.int64], push: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the nodes (n,) of poses with numbers of holds (n,); -1 where there is none, or a number is -1."""

        def keys(pose: NDArray[np.int32], grip: AnyNumbers, push: AnyNumbers) -> NDArray[np.int64]:
            """One number (n,) for each of poses and holds (n,), in the order of all three."""
            return (pose.astype(np.int64) * (len(self.grips) + 1) + grip) * (len(self.pushes) + 1) + push

        # Nodes are in this order.
        own, wanted = keys(self.node_pose, self.node_grip, self.node_push), keys(pose, grip, push)
        at = np.searchsorted(own, wanted)
        found = (grip >= 0) & (push >= 0) & (at < len(own))
        found[found] = own[at[found]] == wanted[found]
        return np.where(found, at, -1)

    def reachable(self) -> NDArray[np.int64]:
        """Return the nodes (k,) that are left and can be come to from a start, over edges that are left."""
        knowledge, count = self.knowledge, self.graph.node_count
        there = knowledge.status != DEAD
        open_edges = ~knowledge.edge_dead & there[self.edge_nodes].all(axis=1)
        ends = self.edge_nodes[open_edges]
        links = coo_array((np.ones(len(ends), bool), (ends[:, 0], ends[:, 1])), shape=(count, count))
        _, part = connected_components(links, directed=False)
        starts = [node for node in self.starts if there[node] and node not in self.lost_starts]
        return np.flatnonzero(np.isin(part, part[starts]) & there)

    def hold_of(self, node: int) -> tuple[HandHold | None, HandHold | None]:
        """Return grip and push of a node."""
        grip, push = int(self.node_grip[node]), int(self.node_push[node])
        return (self.grips[grip - 1] if grip else None, self.pushes[push - 1] if push else None)


def _number_in(holds: tuple[HandHold, ...], wanted: tuple[HandHold, ...]) -> NDArray[np.int64]:
    """Return the numbers (1 + n,) that wanted holds have among others, -1 where they are none; 0 is the absent hand."""
    numbers = {hold: number for number, hold in enumerate(holds, start=1)}
    return np.array([0, *(numbers.get(hold, -1) for hold in wanted)])


def edge_count(
    poses: DenseContactStateGraph,
    holds: tuple[tuple[HandHold, ...], tuple[HandHold, ...]],
    postures: tuple[NDArray[np.uint64], NDArray[np.uint64]],
    ruled_out: NDArray[np.bool_] | None = None,
) -> int:
    """Count the edges that `build_graph` would make, without making them; arguments are its own."""
    candidate = _candidates(*holds, *postures, ruled_out)
    transfers = sum(int(np.count_nonzero(candidate[i] & candidate[j])) for i, j in poses.edges)
    pairs = candidate[:, 1:, 1:]
    alone = np.count_nonzero(pairs & candidate[:, 1:, :1]) + np.count_nonzero(pairs & candidate[:, :1, 1:])
    return transfers + int(alone)


def build_graph(
    poses: DenseContactStateGraph,
    grips: tuple[HandHold, ...],
    pushes: tuple[HandHold, ...],
    grip_postures: NDArray[np.uint64],
    push_postures: NDArray[np.uint64],
    costs: TransitionCost,
    ruled_out: NDArray[np.bool_] | None = None,
) -> ManipulationStateGraph:
    """Merge the graphs of all holds into one.

    Args:
        poses: the dense contact state graph.
        grips: the list of grips, possibly split into postures.
        pushes: the list of pushes, likewise.
        grip_postures: (poses, all grips) bit sets of the postures that reach each pose without collision.
        push_postures: (poses, all pushes) likewise.
        costs: weights of the edge costs.
        ruled_out: (poses, 1 + all grips, 1 + all pushes) which nodes are left out, 0 for the hand that is absent.
    """
    candidate = _candidates(grips, pushes, grip_postures, push_postures, ruled_out)
    node_pose, node_grip, node_push = (axis.astype(np.int32) for axis in np.nonzero(candidate))
    number = np.full(candidate.shape, -1, np.int32)
    number[candidate] = np.arange(len(node_pose), dtype=np.int32)

    transfer = _transfer_edges(poses, number)
    push_comes, grip_comes = _transit_edges(number)
    nodes = np.concatenate([transfer[0], push_comes, grip_comes])
    transits = len(push_comes) + len(grip_comes)
    motion = np.concatenate([transfer[1], np.full(transits, -1, np.int32)])
    is_transit = motion < 0

    rank = np.array([pose.restraint for pose in poses.poses])
    cost = np.zeros((len(nodes), 2))
    cost[~is_transit] = _motion_costs(poses, rank, costs)[motion[~is_transit]]
    effort = np.zeros(len(nodes))
    effort[~is_transit] = np.array([poses.travel(k) for k in range(len(poses.edges))])[motion[~is_transit]]

    graph = graph_from_edges(len(node_pose), nodes[:, 0], nodes[:, 1], cost, is_transit, effort)
    high = np.zeros(len(poses.poses), bool)
    high[list(poses.goals)] = True
    single = (node_grip == 0) != (node_push == 0)
    return ManipulationStateGraph(
        poses=poses,
        grips=grips,
        pushes=pushes,
        node_pose=node_pose,
        node_grip=node_grip,
        node_push=node_push,
        graph=graph,
        edge_kind=is_transit,
        edge_nodes=nodes,
        edge_motion=motion,
        first_transits=(len(transfer[0]), len(transfer[0]) + len(push_comes)),
        starts=tuple(int(n) for n in np.nonzero((node_pose == poses.flat) & single)[0]),
        goal=high[node_pose] & (node_grip > 0) & (node_push > 0),
        load_weight=costs.load,
        knowledge=Knowledge.none(graph),
    )


def _candidates(
    grips: tuple[HandHold, ...],
    pushes: tuple[HandHold, ...],
    grip_postures: NDArray[np.uint64],
    push_postures: NDArray[np.uint64],
    ruled_out: NDArray[np.bool_] | None,
) -> NDArray[np.bool_]:
    """(poses, 1 + grips, 1 + pushes): which hands reach which poses, each hand alone; no hand at all is left out."""
    count = len(grip_postures)
    grip, push = np.ones((count, 1 + len(grips)), bool), np.ones((count, 1 + len(pushes)), bool)
    for column, hold in enumerate(grips, start=1):
        grip[:, column] = (grip_postures[:, hold.index] & np.uint64(hold.postures)) != 0
    for column, hold in enumerate(pushes, start=1):
        push[:, column] = (push_postures[:, hold.index] & np.uint64(hold.postures)) != 0
    candidate = grip[:, :, None] & push[:, None, :]
    candidate[:, 0, 0] = False
    if ruled_out is not None:
        rows = [np.array([0, *(hold.index + 1 for hold in holds)]) for holds in (grips, pushes)]
        candidate &= ~ruled_out[:, rows[0][:, None], rows[1]]
    return candidate


def _transfer_edges(
    poses: DenseContactStateGraph, number: NDArray[np.int32]
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Edges inside the graph of each hold: (E, 2) nodes, and the DCSG edge of each, by which they are ordered."""
    nodes, motions = [np.empty((0, 2), np.int32)], [np.empty(0, np.int32)]
    for k, (i, j) in enumerate(poses.edges):
        both = (number[i] >= 0) & (number[j] >= 0)
        nodes.append(np.column_stack([number[i][both], number[j][both]]))
        motions.append(np.full(len(nodes[-1]), k, np.int32))
    return np.concatenate(nodes), np.concatenate(motions)


def _transit_edges(number: NDArray[np.int32]) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Edges (E, 2) between holds of which one is a subset of the other, at one pose: of each hand and a pair.

    Returns:
        Those on which the push comes or goes, and those on which the grip does, each ordered by pose.
    """
    pairs = number[:, 1:, 1:]
    grip_alone = np.broadcast_to(number[:, 1:, :1], pairs.shape)
    push_alone = np.broadcast_to(number[:, :1, 1:], pairs.shape)

    def with_a_pair(alone: NDArray[np.int32]) -> NDArray[np.int32]:
        """Join nodes (poses, grips, pushes) of one hand to those of both hands, where both are there: (E, 2)."""
        there = (pairs >= 0) & (alone >= 0)
        return np.column_stack([alone[there], pairs[there]])

    return with_a_pair(grip_alone), with_a_pair(push_alone)


def _motion_costs(poses: DenseContactStateGraph, rank: NDArray[np.int64], costs: TransitionCost) -> NDArray[np.float64]:
    """(DCSG edges, 2): cost of each motion forth and back, eqs. (6) and (9)."""
    rows = []
    for i, j in poses.edges:
        if poses.poses[i].contact == poses.poses[j].contact:
            rows.append((costs.same_contact(), costs.same_contact()))
        else:
            rows.append(
                (costs.contact_change(int(rank[i]), int(rank[j])), costs.contact_change(int(rank[j]), int(rank[i])))
            )
    return np.array(rows, float).reshape(-1, 2)
