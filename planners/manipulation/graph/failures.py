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

    def edges(self, graph: ManipulationStateGraph) -> NDArray[np.bool_]:
        """Return which edges (edges,) it kills."""
        node = graph.edge_nodes[:, 0]
        mine, others = _numbers(graph, self.hand)
        dead = np.isin(mine[node], _without(graph, self.hand, self.index, self.survivors))
        if self.alone:
            dead &= others[node] == 0
        return dead & (graph.edge_motion == self.motion)


@dataclass(frozen=True)
class BlockedMotion:
    """Along a motion the plate or the cup meets something that stands in the cell, whoever holds the plate."""

    motion: int

    def edges(self, graph: ManipulationStateGraph) -> NDArray[np.bool_]:
        """Return which edges (edges,) it kills."""
        return graph.edge_motion == self.motion


@dataclass(frozen=True)
class TransitFailure:
    """At a plate pose only some postures of a hand can come or go."""

    pose: int
    hand: Hand
    index: int
    survivors: int

    def edges(self, graph: ManipulationStateGraph) -> NDArray[np.bool_]:
        """Return which edges (edges,) it kills."""
        mine, _ = _numbers(graph, self.hand)
        poor = _without(graph, self.hand, self.index, self.survivors)
        return (
            _changes(graph, self.hand)
            & (graph.node_pose[graph.edge_nodes[:, 0]] == self.pose)
            & np.isin(mine[graph.edge_nodes].max(axis=1), poor)
        )

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

    def edges(self, graph: ManipulationStateGraph) -> NDArray[np.bool_]:
        """Return which edges (n,) it kills: none."""
        return np.zeros(len(graph.edge_motion), bool)


@dataclass(frozen=True)
class PairFailure:
    """No posture of a grip goes with any of a push: along a motion, or when one of the hands comes or goes."""

    grip: HandHold
    push: HandHold
    motion: int | None = None
    pose: int | None = None
    changing: Hand | None = None

    def edges(self, graph: ManipulationStateGraph) -> NDArray[np.bool_]:
        """Return which edges (edges,) it kills."""
        grips = [n for n, hold in enumerate(graph.grips, start=1) if _within(hold, self.grip)]
        pushes = [n for n, hold in enumerate(graph.pushes, start=1) if _within(hold, self.push)]
        ends = graph.edge_nodes
        dead = np.isin(graph.node_grip[ends].max(axis=1), grips) & np.isin(graph.node_push[ends].max(axis=1), pushes)
        if self.motion is not None:
            return dead & (graph.edge_motion == self.motion)
        assert self.changing is not None
        return dead & _changes(graph, self.changing) & (graph.node_pose[ends[:, 0]] == self.pose)


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

    @classmethod
    def of(cls, graph: ManipulationStateGraph, edge: int) -> EdgeFailure:
        """Describe an edge of a graph."""
        one, other = (
            _NodeKey(int(graph.node_pose[node]), *graph.hold_of(int(node))) for node in graph.edge_nodes[edge]
        )
        return cls((one, other))

    def edges(self, graph: ManipulationStateGraph) -> NDArray[np.bool_]:
        """Return which edges (edges,) it kills."""
        one, other = (end.nodes(graph)[graph.edge_nodes] for end in self.ends)
        return (one[:, 0] & other[:, 1]) | (one[:, 1] & other[:, 0])


@dataclass(frozen=True)
class _NodeKey:
    """A node by what it means."""

    pose: int
    grip: HandHold | None
    push: HandHold | None

    def nodes(self, graph: ManipulationStateGraph) -> NDArray[np.bool_]:
        """Return which nodes (nodes,) it, or parts of it, are."""
        return (
            (graph.node_pose == self.pose)
            & _holds_within(graph.grips, self.grip)[graph.node_grip]
            & _holds_within(graph.pushes, self.push)[graph.node_push]
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
        edges = np.flatnonzero(graph.edge_motion == motion)
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
        killed += _kill(graph, np.flatnonzero(failure.edges(graph)))
    return killed


def _kill(graph: ManipulationStateGraph, edges: NDArray[np.int64]) -> int:
    dead = graph.knowledge.edge_dead
    fresh = int((~dead[edges]).sum())
    dead[edges] = True
    return fresh


def _numbers(graph: ManipulationStateGraph, hand: Hand) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Return the nodes' hold numbers of a hand, and of the other."""
    return (graph.node_grip, graph.node_push) if hand == "grip" else (graph.node_push, graph.node_grip)


def _changes(graph: ManipulationStateGraph, hand: Hand) -> NDArray[np.bool_]:
    """Return the edges on which a hand comes or goes."""
    mine, _ = _numbers(graph, hand)
    ends = mine[graph.edge_nodes]
    return graph.edge_kind & (ends[:, 0] != ends[:, 1])


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
