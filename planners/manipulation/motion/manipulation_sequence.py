"""A path through the Manipulation State Graph with what it means: plate poses, motions, and the holds along it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from planners.graph.search import GraphPath
from planners.manipulation.graph.manipulation_graph import HandHold, ManipulationStateGraph
from planners.manipulation.reach.hand_reach import Hand


@dataclass(frozen=True)
class HoldPhase:
    """One hand on the plate from one place of a path to another."""

    hand: Hand
    hold: HandHold
    first: int
    """Place on the path of the first node that has this hold."""
    last: int
    comes: bool = True
    goes: bool = True
    """Whether the hand leaves at the end; at the end of a plan both stay."""


@dataclass(frozen=True)
class ManipulationSequence:
    """A path with what it means: plate poses, motions with their direction, hold phases."""

    path: GraphPath
    poses: tuple[int, ...]
    """Plate pose of each node."""
    motions: tuple[tuple[int, bool] | None, ...]
    """For each edge the DCSG edge and whether it is run from its first to its second pose; None for a transit."""
    phases: tuple[HoldPhase, ...]

    @classmethod
    def of(cls, graph: ManipulationStateGraph, path: GraphPath) -> ManipulationSequence:
        """Read a path of a graph."""
        poses = tuple(int(graph.node_pose[node]) for node in path.nodes)
        motions: list[tuple[int, bool] | None] = []
        for place, edge in enumerate(path.edges):
            motion = int(graph.edge_motion[edge])
            forth = motion >= 0 and int(graph.poses.edges[motion][0]) == poses[place]
            motions.append(None if motion < 0 else (motion, forth))
        return cls(path, poses, tuple(motions), tuple(_phases(graph, path)))

    def active(self, hand: Hand, place: int) -> HoldPhase | None:
        """Return the phase of a hand at a place of the path."""
        for phase in self.phases:
            if phase.hand == hand and phase.first <= place <= phase.last:
                return phase
        return None


def _phases(graph: ManipulationStateGraph, path: GraphPath) -> Iterator[HoldPhase]:
    """Read off when each hand is on the plate."""
    last = len(path.nodes) - 1
    holds: dict[Hand, list[HandHold | None]] = {
        "grip": [graph.hold_of(node)[0] for node in path.nodes],
        "push": [graph.hold_of(node)[1] for node in path.nodes],
    }
    for hand, along in holds.items():
        begin = 0
        for place in range(1, last + 2):
            if place > last or along[place] != along[begin]:
                hold = along[begin]
                if hold is not None:
                    yield HoldPhase(hand, hold, begin, place - 1, goes=place <= last)
                begin = place
