"""From steps of a regrasp sequence to motion: each step becomes planned, checked and timed segments."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np

from planners.collision.model import CollisionQuery
from planners.geometry.pose import Array, Transform, inverse
from planners.graph.rejections import Rejection
from planners.hands.arm_motion import Stuck
from planners.plan.segment import SegmentKind
from planners.regrasp.motion.cartesian_path import (
    CartesianPath,
    Leg,
    Onward,
    Posture,
    StraightLeg,
    TiltLeg,
    raising,
    tilt_of,
)
from planners.regrasp.motion.scene_state import HeldGrasp, SceneState, SegmentWriter
from planners.regrasp.motion.state_queries import StateQueries
from planners.regrasp.motion.tool_exchange import Exchange, HandoverPlace, ToolSwitches
from planners.regrasp.motion.tool_motion import ToolMotion, commonest, moved_by
from planners.regrasp.statics.hold_statics import HoldStatics
from planners.regrasp.tool_segment import SuckedObject
from planners.regrasp.tool_settings import ToolPlannerSettings
from planners.regrasp.tool_workcell import TOOL_FRAME

_UP = np.array([0.0, 0.0, 1.0])


class ToolChoreographer:
    """Plans the motion of single steps in one scene: each leads from one state to the next, or raises `Stuck`."""

    def __init__(
        self,
        queries: StateQueries,
        statics: HoldStatics,
        park: Mapping[str, Array],
        settings: ToolPlannerSettings,
        rng: np.random.Generator,
    ) -> None:
        """Take what all steps share.

        Args:
            queries: collision queries.
            statics: whether cup and fingers hold.
            park: (6,) where each arm stands while the other moves [rad].
            settings: distances, paces and budgets.
            rng: of the searches for free motion.
        """
        self.queries, self.settings = queries, settings
        self.workcell, self.grasps = queries.workcell, queries.grasps
        writer = SegmentWriter(queries.workcell, queries.grasps, queries.T_tool_flanges, settings.timing.sample_step)
        self.motion = ToolMotion(queries, writer, statics, park, settings, rng)
        self.switches = ToolSwitches(queries, writer, statics, settings.pace)

    def pick_up(self, state: SceneState, held: HeldGrasp, branches: int, ahead: Array) -> SceneState:
        """Take the tool from where it rests and lift it straight up; `ahead` (k, 6) says where it goes then."""
        state = self.switches.shaped(self.motion.parked(state, self.workcell.other(held.arm)), held)
        T_world_flange = state.T_world_tool @ self.queries.T_tool_flange(held)
        lift = StraightLeg(T_world_flange, self.settings.carry.off_rest(self.workcell.cell) * _UP)
        cartesian = CartesianPath(self.motion.arm(held.arm), (self.motion.approach(T_world_flange), lift))
        taken = replace(state, holder=held, widths={**state.widths, held.arm: float(self.grasps.widths[held.grasp])})
        close = self.queries.close_pairs(state, frozenset({TOOL_FRAME}))
        posture = self.motion.choose(
            state,
            cartesian,
            branches,
            [self.queries.hand(state, held.arm, around=True), self.queries.carrying(taken, close)],
        )
        state, posture = self.motion.arrive(state, cartesian, posture, SegmentKind.TRANSIT, Onward(ahead, held))
        state = self.motion.straight(state, cartesian, 0, posture, SegmentKind.APPROACH)
        state = self.switches.gripped(state, held)
        return self.motion.straight(state, cartesian, 1, posture, SegmentKind.TRANSFER, close)

    def suck(self, state: SceneState, name: str, T_object_tool: Transform, branches: int, ahead: Array) -> SceneState:
        """Bring the tool onto an object along the facet's normal, and lift both straight up; then go on `ahead`.

        A level tool is turned up before it goes on.
        """
        carry, held = self.settings.carry, state.held
        state = self.motion.parked(state, self.workcell.other(held.arm))
        T_world_tool = state.T_world_objects[name] @ T_object_tool
        T_world_flange = T_world_tool @ self.queries.T_tool_flange(held)
        normal = T_world_tool[:3, 2]
        above = StraightLeg(moved_by(T_world_flange, carry.descent * normal), -carry.descent * normal)
        lift = StraightLeg(T_world_flange, carry.lift * _UP)
        sucked = SuckedObject(name, inverse(T_object_tool))
        bare = replace(state, T_world_tool=T_world_tool)
        laden = replace(bare, sucked=sucked)
        lifted = self._raised(laden)
        cup = self.queries.close_pairs(bare, frozenset({TOOL_FRAME}))
        rest = self.queries.close_pairs(laden, frozenset({TOOL_FRAME, name}))
        beside = self.queries.close_pairs(lifted, lifted.carried)
        on_legs = [self.queries.carrying(bare, cup), self.queries.carrying(laden, rest)]
        ways = [(above, lift)]
        if turns := self._turns(lifted):
            on_legs.append(self.queries.carrying(lifted, beside))
            ways = [(above, lift, turn) for turn in turns]
        cartesian, postures = self._choose(state, ways, branches, on_legs)
        state, posture = self.motion.arrive(state, cartesian, postures, SegmentKind.TRANSFER, Onward(ahead, held))
        state = self.motion.straight(state, cartesian, 0, posture, SegmentKind.TRANSFER, cup)
        state = self.switches.vacuum(replace(state, sucked=sucked), SegmentKind.ATTACH)
        state = self.motion.straight(state, cartesian, 1, posture, SegmentKind.TRANSFER, rest)
        if turns:
            state = self.motion.straight(state, cartesian, 2, posture, SegmentKind.TRANSFER, beside)
        return state

    def put_down(self, state: SceneState, T_world_goal: Transform, branches: int) -> SceneState:
        """Bring tool and object over the goal, lower them, let go, and take the tool off along the facet's normal.

        A tool that is level there is turned level over the goal.
        """
        carry, held, sucked = self.settings.carry, state.held, state.sucked
        assert sucked is not None
        name = sucked.name
        state = self.motion.parked(state, self.workcell.other(held.arm))
        T_world_tool = T_world_goal @ inverse(sucked.T_tool_object)
        T_world_flange = T_world_tool @ self.queries.T_tool_flange(held)
        lowered = StraightLeg(moved_by(T_world_flange, carry.lift * _UP), -carry.lift * _UP)
        leaving = StraightLeg(T_world_flange, carry.descent * T_world_tool[:3, 2])
        laden = replace(state, T_world_tool=T_world_tool, T_world_objects={**state.T_world_objects, name: T_world_goal})
        bare = replace(laden, sucked=None)
        over = self._raised(laden)
        rest = self.queries.close_pairs(laden, frozenset({TOOL_FRAME, name}))
        cup = self.queries.close_pairs(bare, frozenset({TOOL_FRAME}))
        beside = self.queries.close_pairs(over, over.carried)
        on_legs = [self.queries.carrying(laden, rest), self.queries.carrying(bare, cup)]
        ways = [(lowered, leaving)]
        if turns := self._turns(over):
            on_legs.insert(0, self.queries.carrying(over, beside))
            ways = [(turn.back(), lowered, leaving) for turn in turns]
        cartesian, postures = self._choose(state, ways, branches, on_legs)
        home = self.motion.home(held.arm)
        state, posture = self.motion.arrive(state, cartesian, postures, SegmentKind.TRANSFER, home, beside)
        last = len(cartesian.legs) - 1
        if turns:
            state = self.motion.straight(state, cartesian, 0, posture, SegmentKind.TRANSFER, beside)
        state = self.motion.straight(state, cartesian, last - 1, posture, SegmentKind.TRANSFER, rest)
        state = replace(self.switches.vacuum(state, SegmentKind.DETACH), sucked=None)
        return self.motion.straight(state, cartesian, last, posture, SegmentKind.TRANSFER, cup)

    def _raised(self, state: SceneState) -> SceneState:
        """Return the state with tool and object as far up as they are lifted."""
        assert state.sucked is not None
        up, name = self.settings.carry.lift * _UP, state.sucked.name
        objects = {**state.T_world_objects, name: moved_by(state.T_world_objects[name], up)}
        return replace(state, T_world_tool=moved_by(state.T_world_tool, up), T_world_objects=objects)

    def _turns(self, state: SceneState) -> list[TiltLeg]:
        """Return the turns that raise a level tool with its object, to be tried in order; none if it is not level."""
        carry, sucked = self.settings.carry, state.sucked
        assert sucked is not None
        if tilt_of(state.T_world_tool) <= carry.level:
            return []
        T_world_flange = state.T_world_tool @ self.queries.T_tool_flange(state.held)
        body = next(body for body in self.workcell.objects if body.name == sucked.name)
        T_world_object = state.T_world_objects[sucked.name]
        pivot = T_world_object[:3, :3] @ body.com + T_world_object[:3, 3]
        return [TiltLeg(T_world_flange, pivot, raising(state.T_world_tool, tilt)) for tilt in carry.reliefs]

    def _choose(
        self, state: SceneState, ways: Sequence[tuple[Leg, ...]], branches: int, on_legs: Sequence[CollisionQuery]
    ) -> tuple[CartesianPath, list[Posture]]:
        """Return the first of several Cartesian paths that has postures free of collision, and these."""
        *earlier, last = (CartesianPath(self.motion.arm(state.held.arm), way) for way in ways)
        for cartesian in earlier:
            with suppress(Stuck):
                return cartesian, self.motion.choose(state, cartesian, branches, on_legs)
        return last, self.motion.choose(state, last, branches, on_legs)

    def hand_over(
        self, state: SceneState, receiver: HeldGrasp, places: Sequence[HandoverPlace], ahead: Array
    ) -> SceneState:
        """Bring the tool to a handover place, let the other arm take it there, and park the arm that gave it.

        The receiver goes on `ahead` (k, 6). Places are tried in the order given until the budget of motions is spent.
        """
        state = self.motion.parked(state, receiver.arm)
        reasons: Counter[Rejection] = Counter()
        moved = 0
        for place in places:
            if moved >= self.settings.orientations:
                break
            try:
                exchange = Exchange(self.motion, self.switches, state, receiver, place)
                moved += 1
                return exchange.realise(Onward(ahead, receiver))
            except Stuck as stuck:
                reasons[stuck.rejection] += 1
        raise Stuck(commonest(reasons, Rejection("handover", "no place is known for the two grasps")))
