"""Layers and handovers of an object's regrasp graph, for one suction pose after the other."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from planners.collision.model import Fixed, NamePair, Placement, Riding
from planners.geometry.pose import Array, Transform, inverse
from planners.regrasp.graph.grasp_layer import GraspLayer, LayerLoad
from planners.regrasp.graph.handover_ways import HandoverWays, LoadHandovers
from planners.regrasp.graph.object_progress import Tell
from planners.regrasp.graph.suction_route import RouteCosts, RouteStart, SuctionRoute
from planners.regrasp.grasps.grasp_reach import GraspReach, GraspSurroundings
from planners.regrasp.grasps.handovers import HandoverDatabase
from planners.regrasp.grasps.tool_grasps import ToolGraspSettings
from planners.regrasp.motion.scene_state import HeldGrasp, SceneState
from planners.regrasp.motion.state_queries import StateQueries
from planners.regrasp.motion.tool_exchange import HandoverPlace
from planners.regrasp.motion.tool_motion import moved_by
from planners.regrasp.motion.travel_time import NodeTravelTimes
from planners.regrasp.statics.static_hold import StaticHold
from planners.regrasp.suction.suction_poses import SuctionPose
from planners.regrasp.tool_segment import SuckedObject
from planners.regrasp.tool_settings import ToolPlannerSettings
from planners.regrasp.tool_workcell import TOOL_FRAME
from planners.scene.moved_object import MovedObject

_UP = np.array([0.0, 0.0, 1.0])


class RouteMaker:
    """Knows which grasps the tool can be held and passed on in. Nodes are numbered as in the regrasp graph."""

    def __init__(
        self,
        queries: StateQueries,
        handovers: HandoverDatabase,
        static_hold: StaticHold,
        park: Mapping[str, Array],
        settings: ToolPlannerSettings,
    ) -> None:
        """Take what all objects share.

        Args:
            queries: who may come how close to whom.
            handovers: of the cell and the tool.
            static_hold: what cup and fingers hold.
            park: (6,) where each arm stands while the other moves [rad].
            settings: budgets and distances.
        """
        self.queries, self.handovers, self.static_hold, self.settings = queries, handovers, static_hold, settings
        self.workcell = workcell = queries.workcell
        self.grasps, self.arms = handovers.grasps, tuple(workcell.cell.arms)
        self._park = park
        self._at_rest: tuple[SceneState, RouteStart] | None = None
        """The last start with the tool at rest: every order of the objects begins with the same."""
        self._grasp_settings = settings.handovers.grasps
        self._layer_settings = replace(self._grasp_settings, approach=0.0, step=settings.carry.layer_step)
        flanges = [queries.T_tool_flanges[arm] for arm in self.arms]
        self.travel_times = NodeTravelTimes([workcell.arm(arm) for arm in self.arms], flanges, settings.carried)
        self.ways = HandoverWays(handovers, workcell, static_hold, park, self.travel_times, settings.handover_tilt)
        partners = handovers.partners
        counts = np.concatenate([partners.sum(axis=1), partners.sum(axis=0)])
        self.partnerless = 1.0 - counts / max(1, counts.max(initial=0))
        """(2 n,) 0 for the grasp with the most partners to pass the tool on to, 1 for one with none."""

    def held(self, node: int) -> HeldGrasp:
        """Return the arm and the grasp of a node."""
        arm, grasp = divmod(node, len(self.grasps))
        return HeldGrasp(self.arms[arm], grasp)

    def start(self, state: SceneState) -> RouteStart:
        """Return the grasps the tool can be held in: the one it is held in, or all with which it can be picked up."""
        count = len(self.grasps)
        if state.holder is not None:
            node = self.node(state.holder)
            nodes = np.zeros(2 * count, dtype=bool)
            nodes[node] = True
            positions = np.full((2 * count, 1, 6), np.nan)
            positions[node, 0] = state.q[self.workcell.joints(state.holder.arm)]
            return RouteStart(nodes, positions, None)
        if self._at_rest is None or self._at_rest[0] is not state:
            # It may stand closer to its rest than bodies are kept apart, and comes off it beside that.
            beside = self.queries.close_pairs(state, frozenset({TOOL_FRAME}))
            reach = self._reach(state, {}, beside, self._grasp_settings)
            load = LayerLoad.of(self.static_hold, None, self.settings.torque.posture_reserve)
            rest = GraspLayer(state.T_world_tool, reach, self.settings.carry.off_rest(self.workcell.cell) * _UP, load)
            nodes = rest.ask(np.ones(2 * count, dtype=bool))
            self._at_rest = state, RouteStart(nodes, rest.solutions, rest)
        return self._at_rest[1]

    def routes(
        self,
        state: SceneState,
        target: MovedObject,
        poses: Sequence[SuctionPose],
        start: RouteStart,
        costs: RouteCosts,
        tell: Tell,
    ) -> Iterator[SuctionRoute]:
        """Yield all ways to move an object, one suction pose after the other; nothing of them is asked yet."""
        lift = self.settings.carry.lift * _UP
        T_world_object = state.T_world_objects[target.name]
        riding: dict[str, Placement | None] = {target.name: Riding("tool", np.eye(4))}
        beside = [self._beside(state, target.name, T) for T in (T_world_object, target.T_world_goal)]
        here = there = self._reach(state, riding, beside[0], self._layer_settings)
        if beside[0] != beside[1]:
            there = self._reach(state, riding, beside[1], self._layer_settings)
        for pose in poses:
            sucked = SuckedObject(target.name, inverse(pose.T_object_tool))
            load = LayerLoad.of(self.static_hold, sucked, self.settings.torque.posture_reserve)
            suction = GraspLayer(T_world_object @ pose.T_object_tool, here, lift, load)
            goals = tuple(GraspLayer(T @ pose.T_object_tool, there, lift, load) for T in target.goals)
            passing = LoadHandovers(self.ways, sucked)
            yield SuctionRoute(pose, start, (suction, goals), passing, costs, self.settings.most_handovers, tell)

    def node(self, held: HeldGrasp) -> int:
        """Return the node of an arm and a grasp."""
        return self.arms.index(held.arm) * len(self.grasps) + held.grasp

    def places(self, state: SceneState, receiver: int, ahead: Array) -> list[HandoverPlace]:
        """Return where the holder can hand the tool to a node that goes on to `ahead` (k, 6), shortest way first."""
        q = {arm: state.q[self.workcell.joints(arm)] for arm in self.arms}
        return self.ways.places(q, self.node(state.held), receiver, state.sucked, ahead)

    def on_the_way(self, state: SceneState, node: int, between: GraspLayer, ahead: Array) -> tuple[int, ...]:
        """Return the branches of a grasp in a layer: those on a shortest way to `ahead` (k, 6) first, then all."""
        branches = int(between.branches[node])
        if not len(ahead):
            return (branches,)
        here = state.q[self.workcell.joints(self.held(node).arm)][None]
        carries = state.holder is not None
        seconds = [
            self.travel_times.of(node, here, q, carries=carries) + self.travel_times.of(node, q, ahead)
            for q in between.solutions[node][:, None]
        ]
        near = [b for b, each in enumerate(seconds) if each <= min(seconds) + self.settings.detour]
        chosen = sum(1 << b for b in near) & branches
        return (branches,) if chosen in (0, branches) else (chosen, branches)

    def _beside(self, state: SceneState, name: str, T_world_object: Transform) -> dict[NamePair, float]:
        """Return margins of the pairs that an object is closer in than usual where it stands, but for what is below."""
        raised = moved_by(T_world_object, self.settings.carry.layer_step * _UP)
        standing = replace(state, sucked=None, T_world_objects={**state.T_world_objects, name: raised})
        close = self.queries.close_pairs(standing, frozenset({name}))
        return {pair: margin for pair, margin in close.items() if TOOL_FRAME not in pair}

    def _reach(
        self,
        state: SceneState,
        riding: Mapping[str, Placement | None],
        margins: Mapping[NamePair, float],
        settings: ToolGraspSettings,
    ) -> dict[str, GraspReach]:
        """Return each arm's reach among the objects where they stand, or ride; the other arm is parked."""
        objects: dict[str, Placement | None] = {name: Fixed(T) for name, T in state.T_world_objects.items()}
        objects |= riding
        reach = {}
        for arm in self.arms:
            other = self.workcell.other(arm)
            around = GraspSurroundings(objects, self._park[other], state.widths[other], margins)
            reach[arm] = GraspReach(self.workcell, arm, self.grasps, around, settings)
        return reach
