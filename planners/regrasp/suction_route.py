"""All ways to move one object with one suction pose: its layers of grasps and its regrasp graph."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planners.geometry.pose import Array, rotation_angle
from planners.graph.rejections import Rejection
from planners.regrasp.grasp_layer import GraspLayer, NodeMask
from planners.regrasp.object_progress import ObjectStage, Tell
from planners.regrasp.regrasp_graph import Edge, RegraspGraph, RoundLayers, Sequence
from planners.regrasp.suction_poses import SuctionPose

HandoverMasks = tuple[NDArray[np.bool_], NDArray[np.bool_]]
"""(n, n) left to right, and right to left."""


@dataclass(frozen=True, eq=False)
class RouteStart:
    """Where a route begins: the grasps in which the tool is or can be held."""

    nodes: NodeMask
    """(2 n,)"""
    positions: Array
    """(2 n, k, 6) joint positions of each node there, NaN where there are none [rad]."""
    layer: GraspLayer | None
    """What was found out where the tool rests; None where a hand holds it already."""


@dataclass(frozen=True, eq=False)
class RouteCosts:
    """What makes one sequence better than another with as many handovers, in seconds of the slowest joint."""

    last_grasp: Array
    """(2 n,) cost of ending with a grasp."""


class SuctionRoute:
    """One suction pose of one object, from the tool where it is to the object at one of its goals."""

    def __init__(
        self,
        pose: SuctionPose,
        start: RouteStart,
        layers: tuple[GraspLayer, tuple[GraspLayer, ...]],
        handovers: tuple[HandoverMasks, HandoverMasks],
        costs: RouteCosts,
        most_handovers: int,
        tell: Tell,
    ) -> None:
        """Ask nothing yet.

        Args:
            pose: the suction pose.
            start: where the tool is.
            layers: of the suction pose at the object's start, and at each of its goals.
            handovers: of the tool alone, and with the object.
            costs: what the sequences cost.
            most_handovers: in one round.
            tell: told what is being done.
        """
        self.pose, self.start, self.costs = pose, start, costs
        self.suction, self.goals = layers
        self._handovers, self._most, self.tell = handovers, most_handovers, tell
        self.tried: dict[Edge, Rejection | None] = {}
        """Edges whose motion was tried; those that failed are deleted, the reason says why."""
        self.sequences = 0
        """How many sequences were tried."""
        self._graphs: dict[tuple[int, int], RegraspGraph] = {}
        self.goal_order = sorted(range(len(self.goals)), key=self._turn_to)

    def best(self, handovers: int, goals: int) -> Sequence | None:
        """Return the cheapest sequence that is left with this many handovers, to one of the `goals` nearest goals."""
        key = (handovers, min(goals, len(self.goals)))
        if key not in self._graphs:
            self._ask(*key)
            self.tell(ObjectStage.GRAPH)
            graph = RegraspGraph(self.start.nodes, self._rounds(key[1]), self._most)
            for edge, rejection in self.tried.items():
                if rejection is not None:
                    graph.delete(edge)
            self._graphs[key] = graph
        return self._graphs[key].best(handovers)

    def passed(self, edge: Edge) -> None:
        """Note that the motion of an edge was found."""
        self.tried.setdefault(edge, None)

    def delete(self, edge: Edge, rejection: Rejection) -> None:
        """Take an edge out of the graph for good."""
        self.tried[edge] = rejection
        for graph in self._graphs.values():
            graph.delete(edge)

    def emptiness(self) -> Rejection:
        """Say why there was no sequence, of layers that were asked as far as sequences could use them."""
        if not self.suction.reached.any():
            return _empty("No grasp has the tool on the object at its start", self.suction)
        if not any(goal.reached.any() for goal in self.goals):
            return _empty("No grasp has the tool on the object at its goal", self.goals[self.goal_order[0]])
        reason = f"No grasps lead from start to goal with at most {self._most} handovers a round."
        return Rejection("grasp", reason)

    @property
    def handover_pairs(self) -> tuple[int, int]:
        """Pairs of grasps that pass the tool on, alone and with the object."""
        first, second = (int(masks[0].sum()) for masks in self._handovers)
        return first, second

    @property
    def edge_count(self) -> int:
        """Edges of the largest graph so far."""
        return max((graph.edge_count for graph in self._graphs.values()), default=0)

    @property
    def asked(self) -> int:
        """Nodes that were asked in all layers."""
        return self.suction.asked + sum(goal.asked for goal in self.goals)

    def _ask(self, handovers: int, goals: int) -> None:
        """Ask the layers for the grasps that sequences with this many handovers could use."""
        before = [self.start.nodes]
        for _ in range(min(handovers, self._most)):
            before.append(_handed(before[-1], self._handovers[0]))
        for first in range(min(handovers, self._most) + 1):
            self.tell(ObjectStage.FIRST_REGRASP)
            after = self.suction.ask(before[first])
            for _ in range(handovers - first):
                after = _handed(after, self._handovers[1])
            self.tell(ObjectStage.SECOND_REGRASP)
            if handovers - first <= self._most and after.any():
                for goal in self.goal_order[:goals]:
                    self.goals[goal].ask(after)

    def _rounds(self, goals: int) -> tuple[RoundLayers, RoundLayers]:
        nodes = len(self.start.nodes)
        free = np.zeros(nodes)
        at_suction = np.where(self.suction.reached, 0.0, np.inf)[None]
        first = RoundLayers(
            direct=at_suction + self.suction.travel_from(self.start.positions),
            departing=free,
            arriving=at_suction,
            handovers=self._handovers[0],
        )
        direct = np.full((len(self.goals), nodes), np.inf)
        arriving = direct.copy()
        for goal in self.goal_order[:goals]:
            layer = self.goals[goal]
            arriving[goal] = np.where(layer.reached, self.costs.last_grasp, np.inf)
            direct[goal] = arriving[goal] + layer.travel_from(self.suction.solutions)
        second = RoundLayers(direct=direct, departing=free, arriving=arriving, handovers=self._handovers[1])
        return first, second

    def _turn_to(self, goal: int) -> float:
        """How far the tool turns from the object's start to a goal [rad]: goals that turn it little come first."""
        there = self.goals[goal].T_world_tool
        return round(rotation_angle(self.suction.T_world_tool[:3, :3], there[:3, :3]), 6)


def _empty(what: str, layer: GraspLayer) -> Rejection:
    """Return that a layer has no node, with what keeps most of them away."""
    counts = {reason: int(mask.sum()) for reason, mask in layer.rejected().items()}
    if not counts:
        return Rejection("grasp", f"{what} that any hand could get hold of it in.")
    return Rejection("grasp", f"{what}: {max(counts, key=counts.__getitem__)}")


def _handed(nodes: NodeMask, handovers: HandoverMasks) -> NodeMask:
    """Return the nodes (2 n,) that can have the tool after a handover from any of `nodes`."""
    n = len(nodes) // 2
    left_to_right, right_to_left = handovers
    return np.concatenate([right_to_left[nodes[n:]].any(axis=0), left_to_right[nodes[:n]].any(axis=0)])
