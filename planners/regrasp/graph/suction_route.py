"""All ways to move one object with one suction pose: its layers of grasps and its regrasp graph."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from planners.geometry.pose import Array, rotation_angle
from planners.graph.rejections import Rejection
from planners.regrasp.graph.grasp_layer import GraspLayer, NodeMask
from planners.regrasp.graph.handover_ways import HandoverMasks, LoadHandovers
from planners.regrasp.graph.object_progress import ObjectStage, Tell
from planners.regrasp.graph.regrasp_graph import Edge, LayeredRegraspGraph, RoundLayers, Sequence
from planners.regrasp.motion.travel_time import NodeTravelTimes
from planners.regrasp.statics.hold_statics import UNGRIPPED
from planners.regrasp.suction.suction_poses import SuctionPose
from planners.scene.moved_object import side_of


@dataclass(frozen=True, eq=False)
class RouteStart:
    """Where a route begins: the grasps in which the tool is or can be held."""

    nodes: NodeMask
    """(2 n,)"""
    positions: Array
    """(2 n, k, 6) joint positions of each node there, NaN where there are none [rad]."""
    layer: GraspLayer | None
    """What was found out where the tool rests; None where a hand holds it already."""

    @staticmethod
    def nowhere(nodes: int) -> RouteStart:
        """Return the start of routes whose layers alone are of interest."""
        return RouteStart(np.zeros(nodes, dtype=bool), np.full((nodes, 1, 6), np.nan), None)


@dataclass(frozen=True, eq=False)
class RouteCosts:
    """What makes one sequence better than another with as many handovers, in seconds."""

    onward: Callable[[Array], Array]
    """From joint positions (2 n, k, 6) at the end to the cost (2 n,) of ending with each grasp."""
    travel_times: NodeTravelTimes
    """From place to place."""


class SuctionRoute:
    """One suction pose of one object, from the tool where it is to the object at one of its goals."""

    def __init__(
        self,
        pose: SuctionPose,
        start: RouteStart,
        layers: tuple[GraspLayer, tuple[GraspLayer, ...]],
        handovers: LoadHandovers,
        costs: RouteCosts,
        most_handovers: int,
        tell: Tell,
    ) -> None:
        """Ask nothing yet.

        Args:
            pose: the suction pose.
            start: where the tool is.
            layers: of the suction pose at the object's start, and at each of its goals.
            handovers: of the tool alone, and with the object; direct routes do not ask for them.
            costs: what the sequences cost.
            most_handovers: in one round.
            tell: told what is being done.
        """
        self.pose, self.start, self.costs = pose, start, costs
        self.suction, self.goals = layers
        self.handovers, self._most, self.tell = handovers, most_handovers, tell
        self.tried: dict[Edge, Rejection | None] = {}
        """Edges whose motion was tried; those that failed are deleted, the reason says why."""
        self.sequences = 0
        """How many sequences were tried."""
        self._graphs: dict[tuple[int, int], LayeredRegraspGraph | None] = {}
        """None: no sequence can lead through the layers, as far as they were asked."""
        tools = [self.suction.T_world_tool, *(goal.T_world_tool for goal in self.goals)]
        self._side = side_of(np.array(tools), np.zeros(3))
        self.goal_order = sorted(range(len(self.goals)), key=self._turn_to)

    def best(self, handovers: int, goals: int) -> Sequence | None:
        """Return the cheapest sequence that is left with this many handovers, to one of the `goals` nearest goals."""
        key = (handovers, min(goals, len(self.goals)))
        if key not in self._graphs:
            self._ask(*key)
            self.tell(ObjectStage.GRAPH)
            leads_on = self.suction.reached.any() and any(goal.reached.any() for goal in self.goals)
            self._graphs[key] = self._graph(*key) if leads_on else None
        graph = self._graphs[key]
        return None if graph is None else graph.best(handovers)

    def passed(self, edge: Edge) -> None:
        """Note that the motion of an edge was found."""
        self.tried.setdefault(edge, None)

    def delete(self, edge: Edge, rejection: Rejection) -> None:
        """Take an edge out of the graph for good."""
        self.tried[edge] = rejection
        for graph in filter(None, self._graphs.values()):
            graph.delete(edge)

    def cost_to_go(self, node: int, q: Array) -> float:
        """Return what it costs to end with a grasp where its arm is at `q` (6,) [s]."""
        positions = np.full((len(self.start.nodes), 1, 6), np.nan)
        positions[node, 0] = q
        return float(self.costs.onward(positions)[node])

    def emptiness(self) -> Rejection:
        """Say why there was no sequence, of layers that were asked as far as sequences could use them."""
        if not self.suction.reached.any():
            return _empty("start", self.suction)
        if not any(goal.reached.any() for goal in self.goals):
            return _empty("goal", self.goals[self.goal_order[0]])
        reason = f"No grasps lead from start to goal with at most {self._most} handovers a round."
        return Rejection("grasp", reason)

    @property
    def handover_pairs(self) -> tuple[int, int]:
        """Pairs of grasps that pass the tool on, alone and with the object."""
        first, second = (int(masks[0].sum()) for masks in self.handovers.masks)
        return first, second

    @property
    def edge_count(self) -> int:
        """Edges of the largest graph so far."""
        return max((graph.edge_count for graph in filter(None, self._graphs.values())), default=0)

    @property
    def asked(self) -> int:
        """Nodes that were asked in all layers."""
        return self.suction.asked + sum(goal.asked for goal in self.goals)

    def _ask(self, handovers: int, goals: int) -> None:
        """Ask the layers for the grasps that sequences with this many handovers could use."""
        # Where no grasp bears what is on the cup, it does not matter which ones a handover leads to.
        most = min(handovers, self._most) if self.suction.holds.any() else 0
        before = [self.start.nodes]
        for _ in range(most):
            before.append(_handed(before[-1], self.handovers.masks[0]))
        for first in range(most + 1):
            self.tell(ObjectStage.FIRST_REGRASP)
            after = self.suction.ask(before[first])
            for _ in range(handovers - first if after.any() else 0):
                after = _handed(after, self.handovers.masks[1])
            self.tell(ObjectStage.SECOND_REGRASP)
            if handovers - first <= self._most and after.any():
                for goal in self.goal_order[:goals]:
                    self.goals[goal].ask(after)

    def _graph(self, handovers: int, goals: int) -> LayeredRegraspGraph:
        graph = LayeredRegraspGraph(self.start.nodes, self._rounds(handovers, goals), self._most if handovers else 0)
        for edge, rejection in self.tried.items():
            if rejection is not None:
                graph.delete(edge)
        return graph

    def _rounds(self, handovers: int, goals: int) -> tuple[RoundLayers, RoundLayers]:
        seconds_between, nodes = self.costs.travel_times.between, len(self.start.nodes)
        nowhere, nobody = np.full((1, nodes), np.inf), np.zeros((nodes // 2, nodes // 2), dtype=bool)
        direct = seconds_between(self.start.positions, self.suction.solutions)[None]
        first = RoundLayers(direct, nowhere[0], nowhere, (nobody, nobody))
        layers = {goal: self.goals[goal] for goal in self.goal_order[:goals]}
        ends = np.full((len(self.goals), nodes), np.inf)
        direct, arriving = ends.copy(), ends.copy()
        onward = {goal: self.costs.onward(layer.solutions) for goal, layer in layers.items() if layer.reached.any()}
        for goal, seconds in onward.items():
            direct[goal] = seconds + seconds_between(self.suction.solutions, layers[goal].solutions)
        second = RoundLayers(direct, nowhere[0], arriving, (nobody, nobody))
        if not handovers:
            return first, second
        alone, laden = self.handovers.positions
        receiving = self.handovers.ways.receiving
        for goal, seconds in onward.items():
            arriving[goal] = seconds + receiving + seconds_between(laden, layers[goal].solutions)
        first = replace(
            first,
            departing=seconds_between(self.start.positions, alone),
            arriving=(receiving + seconds_between(alone, self.suction.solutions))[None],
            handovers=self.handovers.masks[0],
        )
        second = replace(
            second, departing=seconds_between(self.suction.solutions, laden), handovers=self.handovers.masks[1]
        )
        return first, second

    def _turn_to(self, goal: int) -> tuple[float, float]:
        """How far the tool turns from the object's start to a goal [rad]: goals that turn it little come first.

        Of those that turn it as far, the one that turns it towards the robot's middle.
        """
        here, there = self.suction.T_world_tool[:3, :3], self.goals[goal].T_world_tool[:3, :3]
        turn = there @ here.T
        return round(rotation_angle(here, there), 6), round(self._side * float(turn[1, 0] - turn[0, 1]), 6)


def _empty(end: str, layer: GraspLayer) -> Rejection:
    """Return the rejection of a layer without a node, at start or goal: what keeps its grasps away."""
    name = layer.object_name
    hindrance = layer.hindrance()
    reason = f"No grasp has the tool on {name} at its {end}: {hindrance.rstrip('.')}."
    if hindrance == UNGRIPPED and (squeeze := layer.missing_squeeze()) is not None:
        return Rejection.measured("grasp", reason, name, *squeeze, "N")
    return Rejection("grasp", reason, name)


def _handed(nodes: NodeMask, handovers: HandoverMasks) -> NodeMask:
    """Return the nodes (2 n,) that can have the tool after a handover from any of `nodes`."""
    n = len(nodes) // 2
    left_to_right, right_to_left = handovers
    return np.concatenate([right_to_left[nodes[n:]].any(axis=0), left_to_right[nodes[:n]].any(axis=0)])
