"""What was found impossible beyond single nodes, in terms of holds and postures.

Failures outlive the graph they were found in: when holds are split into postures and the graph is built anew, they
are applied again. Each kills the edges of all holds whose postures it leaves none of.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planners.manipulation.graph.manipulation_graph import HandHold, ManipulationStateGraph
from planners.manipulation.reach.hand_reach import Hand
from planners.manipulation.statics.hold_balance import HoldBalance


@dataclass(frozen=True)
class MotionFailure:
    """Along a motion of the plate only some postures of a hand survive."""

    motion: int
    hand: Hand
    index: int
    survivors: int
    alone: bool
    """Whether this holds only where the other arm idles."""

    def edges(self, graph: ManipulationStateGraph) -> NDArray[np.int64]:
        """Return the edges (n,) that it kills."""
        edges = graph.transfers(self.motion)
        node = graph.edge_nodes[edges, 0]
        mine, others = _numbers(graph, self.hand)
        dead = np.isin(mine[node], _without(graph, self.hand, self.index, self.survivors))
        if self.alone:
            dead &= others[node] == 0
        return edges[dead]


@dataclass(frozen=True)
class BlockedMotion:
    """Along a motion the plate or the cup meets something that stands in the cell, whoever holds the plate."""

    motion: int

    def edges(self, graph: ManipulationStateGraph) -> NDArray[np.int64]:
        """Return the edges (n,) that it kills."""
        return graph.transfers(self.motion)


@dataclass(frozen=True)
class TransitFailure:
    """At a plate pose only some postures of a hand can come or go."""

    pose: int
    hand: Hand
    index: int
    survivors: int

    def edges(self, graph: ManipulationStateGraph) -> NDArray[np.int64]:
        """Return the edges (n,) that it kills."""
        edges = graph.transits(self.pose, self.hand)
        mine, _ = _numbers(graph, self.hand)
        poor = _without(graph, self.hand, self.index, self.survivors)
        return edges[np.isin(mine[graph.edge_nodes[edges, 1]], poor)]

    def nodes(self, graph: ManipulationStateGraph) -> Iterator[int]:
        """Return the start nodes it kills: a plan begins with a hand that comes, on no edge of the graph."""
        mine, _ = _numbers(graph, self.hand)
        poor = _without(graph, self.hand, self.index, self.survivors)
        return (node for node in graph.starts if graph.node_pose[node] == self.pose and mine[node] in poor)


@dataclass(frozen=True)
class RiseFailure:
    """From a goal pose only some postures of a hand go straight up.

    It kills nothing: which nodes are goals is asked of `RisingReach` when they are examined.
    """

    pose: int
    hand: Hand
    index: int
    survivors: int

    def edges(self, graph: ManipulationStateGraph) -> NDArray[np.int64]:
        """Return the edges (n,) that it kills: none."""
        del graph
        return np.empty(0, np.int64)


@dataclass(frozen=True)
class PairFailure:
    """No posture of a grip goes with any of a push: along a motion, or when one of the hands comes or goes."""

    grip: HandHold
    push: HandHold
    motion: int | None = None
    pose: int | None = None
    changing: Hand | None = None

    @property
    def coming(self) -> HandHold | None:
        """The hold of the hand that comes or goes; None along a motion."""
        return None if self.changing is None else self.grip if self.changing == "grip" else self.push

    def edges(self, graph: ManipulationStateGraph) -> NDArray[np.int64]:
        """Return the edges (n,) that it kills."""
        if self.motion is not None:
            edges = graph.transfers(self.motion)
        else:
            assert self.pose is not None
            assert self.changing is not None
            edges = graph.transits(self.pose, self.changing)
        # Both hands are there at the second end of either.
        node = graph.edge_nodes[edges, 1]
        of_grip, of_push = _holds_within(graph.grips, self.grip), _holds_within(graph.pushes, self.push)
        return edges[of_grip[graph.node_grip[node]] & of_push[graph.node_push[node]]]


@dataclass(frozen=True)
class LoneTransitFailure:
    """The start of a plan: a hand cannot come to a start node by free motion."""

    start_hold: HandHold
    hand: Hand

    def nodes(self, graph: ManipulationStateGraph) -> Iterator[int]:
        """Return the start nodes it kills."""
        mine, _ = _numbers(graph, self.hand)
        holds = graph.grips if self.hand == "grip" else graph.pushes
        for node in graph.starts:
            if mine[node] and _within(holds[mine[node] - 1], self.start_hold):
                yield node


@dataclass(frozen=True)
class EdgeFailure:
    """One edge was given up, told by its two nodes so that it can be found again in a graph with split holds."""

    ends: tuple[_NodeKey, _NodeKey]
    motion: int
    """Of the plate; -1: a hand comes or goes."""

    @classmethod
    def of(cls, graph: ManipulationStateGraph, edge: int) -> EdgeFailure:
        """Describe an edge of a graph."""
        one, other = (
            _NodeKey(int(graph.node_pose[node]), *graph.hold_of(int(node))) for node in graph.edge_nodes[edge]
        )
        return cls((one, other), int(graph.edge_motion[edge]))

    def edges(self, graph: ManipulationStateGraph) -> NDArray[np.int64]:
        """Return the edges (n,) that it kills."""
        if self.motion < 0:
            pose = self.ends[0].pose
            edges = np.concatenate([graph.transits(pose, "push"), graph.transits(pose, "grip")])
        else:
            edges = graph.transfers(self.motion)
        one, other = (end.are(graph, graph.edge_nodes[edges]) for end in self.ends)
        return edges[(one[:, 0] & other[:, 1]) | (one[:, 1] & other[:, 0])]


@dataclass(frozen=True)
class _NodeKey:
    """A node by what it means."""

    pose: int
    grip: HandHold | None
    push: HandHold | None

    def are(self, graph: ManipulationStateGraph, nodes: NDArray[np.int32]) -> NDArray[np.bool_]:
        """Return (...,) which of some nodes (...,), by number, are it, or parts of it."""
        return (
            (graph.node_pose[nodes] == self.pose)
            & _holds_within(graph.grips, self.grip)[graph.node_grip[nodes]]
            & _holds_within(graph.pushes, self.push)[graph.node_push[nodes]]
        )


GraphFailure = (
    EdgeFailure | MotionFailure | BlockedMotion | TransitFailure | PairFailure | LoneTransitFailure | RiseFailure
)


class Failures:
    """All failures so far, and the balance failures along motions."""

    def __init__(self, balance: HoldBalance) -> None:
        self._balance = balance
        self._failures: list[GraphFailure] = []
        self._unbalanced_motions: set[int] = set()

    def of_reach(self, balance: HoldBalance) -> Failures:
        """Return what is known with another reserve: what does not depend on forces, and what its balance knows."""
        kept = Failures(balance)
        # With another reserve other edges are given up.
        kept._failures = [failure for failure in self._failures if not isinstance(failure, EdgeFailure)]
        kept._unbalanced_motions = balance.unbalanced_motions()
        return kept

    def add(self, failure: GraphFailure, graph: ManipulationStateGraph) -> int:
        """Remember a failure and apply it; return how many edges or nodes it killed."""
        self._failures.append(failure)
        return _apply(failure, graph)

    def coming_in_vain(self, failure: PairFailure) -> list[HandHold]:
        """Return the hold that cannot come or go at a pose, once for each of the other hand with which that is known.

        It is the same hold each time, but perhaps with other postures.
        """
        return [
            each.coming
            for each in self._failures
            if isinstance(each, PairFailure)
            and each.coming is not None
            and failure.coming is not None
            and (each.pose, each.changing, each.coming.index) == (failure.pose, failure.changing, failure.coming.index)
        ]

    def add_unbalanced(self, motion: int, graph: ManipulationStateGraph) -> int:
        """Kill the edges of all holds that are known not to bear the plate along a motion."""
        self._unbalanced_motions.add(motion)
        return self._apply_unbalanced(motion, graph)

    def apply(self, graph: ManipulationStateGraph) -> None:
        """Apply everything to a graph that was built anew."""
        for failure in self._failures:
            _apply(failure, graph)
        for motion in self._unbalanced_motions:
            self._apply_unbalanced(motion, graph)

    def _apply_unbalanced(self, motion: int, graph: ManipulationStateGraph) -> int:
        impossible = self._balance.impossible_holds(motion)
        edges = graph.transfers(motion)
        node = graph.edge_nodes[edges, 0]
        grip_row = np.array([0, *(hold.index + 1 for hold in graph.grips)])[graph.node_grip[node]]
        push_row = np.array([0, *(hold.index + 1 for hold in graph.pushes)])[graph.node_push[node]]
        return _kill(graph, edges[impossible[grip_row, push_row]])


def _apply(failure: GraphFailure, graph: ManipulationStateGraph) -> int:
    killed = 0
    if isinstance(failure, LoneTransitFailure | TransitFailure):
        lost = set(failure.nodes(graph)) - graph.lost_starts
        graph.lost_starts.update(lost)
        killed += len(lost)
    if not isinstance(failure, LoneTransitFailure):
        killed += _kill(graph, failure.edges(graph))
    return killed


def _kill(graph: ManipulationStateGraph, edges: NDArray[np.int64]) -> int:
    """Have edges (k,) dead, and return how many were not before."""
    dead = graph.knowledge.edge_dead
    fresh = int((~dead[edges]).sum())
    dead[edges] = True
    return fresh


def _numbers(graph: ManipulationStateGraph, hand: Hand) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Return the numbers (nodes,) of the holds of a hand, and of the other; 0 is the absent hand."""
    return (graph.node_grip, graph.node_push) if hand == "grip" else (graph.node_push, graph.node_grip)


def _without(graph: ManipulationStateGraph, hand: Hand, index: int, survivors: int) -> list[int]:
    """Numbers of the holds with this index that have none of the surviving postures."""
    holds = graph.grips if hand == "grip" else graph.pushes
    return [n for n, hold in enumerate(holds, start=1) if hold.index == index and not hold.postures & survivors]


def _holds_within(holds: tuple[HandHold, ...], hold: HandHold | None) -> NDArray[np.bool_]:
    """(1 + holds,) by hold number, 0 for an absent hand: whether it is `hold`, or one that it was split into."""
    if hold is None:
        return np.array([True] + [False] * len(holds))
    return np.array([False] + [_within(other, hold) for other in holds])


def _within(hold: HandHold, other: HandHold) -> bool:
    return hold.index == other.index and not hold.postures & ~other.postures
