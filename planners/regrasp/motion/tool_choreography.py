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
from planners.regrasp.grasps.tool_grasps import TOOL_FRAME
from planners.regrasp.motion.cartesian_legs import Leg, Onward, Posture, StraightLeg, TiltLeg, Visit, raising, tilt_of
from planners.regrasp.motion.tool_exchange import Exchange, HandoverPlace
from planners.regrasp.motion.tool_motion import Stuck, ToolMotion, commonest, moved_by
from planners.regrasp.motion.tool_queries import ToolTraffic
from planners.regrasp.motion.tool_stage import HeldGrasp, StageWriter, ToolStage
from planners.regrasp.motion.tool_switches import ToolSwitches
from planners.regrasp.statics.hold_statics import HoldStatics
from planners.regrasp.tool_segment import SuckedObject
from planners.regrasp.tool_settings import ToolPlannerSettings
from planners.segment import SegmentKind

_UP = np.array([0.0, 0.0, 1.0])


class ToolChoreographer:
    """Plans the motion of single steps in one scene: each leads from one stage to the next, or raises `Stuck`."""

    def __init__(
        self,
        traffic: ToolTraffic,
        statics: HoldStatics,
        park: Mapping[str, Array],
        settings: ToolPlannerSettings,
        rng: np.random.Generator,
    ) -> None:
        """Take what all steps share.

        Args:
            traffic: collision queries.
            statics: whether cup and fingers hold.
            park: (6,) where each arm stands while the other moves [rad].
            settings: distances, paces and budgets.
            rng: of the searches for free motion.
        """
        self.traffic, self.settings = traffic, settings
        self.workcell, self.grasps = traffic.workcell, traffic.grasps
        writer = StageWriter(traffic.workcell, traffic.grasps, settings.timing.sample_step)
        self.motion = ToolMotion(traffic, writer, statics, park, settings, rng)
        self.switches = ToolSwitches(traffic, writer, statics, settings.pace)

    def pick_up(self, stage: ToolStage, held: HeldGrasp, branches: int, ahead: Array) -> ToolStage:
        """Take the tool from where it rests and lift it straight up; `ahead` (k, 6) says where it goes then."""
        stage = self.switches.shaped(self.motion.parked(stage, self.workcell.other(held.arm)), held)
        T_world_flange = stage.T_world_tool @ self.traffic.T_tool_flange(held)
        lift = StraightLeg(T_world_flange, self.settings.carry.unrest * _UP)
        visit = Visit(self.motion.arm(held.arm), (self.motion.approach(T_world_flange), lift))
        taken = replace(stage, holder=held, widths={**stage.widths, held.arm: float(self.grasps.widths[held.grasp])})
        close = self.traffic.close_pairs(stage, frozenset({TOOL_FRAME}))
        posture = self.motion.choose(
            stage,
            visit,
            branches,
            [self.traffic.hand(stage, held.arm, around=True), self.traffic.carrying(taken, close)],
        )
        stage, posture = self.motion.arrive(stage, visit, posture, SegmentKind.TRANSIT, Onward(ahead, held))
        stage = self.motion.straight(stage, visit, 0, posture, SegmentKind.APPROACH)
        stage = self.switches.gripped(stage, held)
        return self.motion.straight(stage, visit, 1, posture, SegmentKind.TRANSFER, close)

    def suck(self, stage: ToolStage, name: str, T_object_tool: Transform, branches: int, ahead: Array) -> ToolStage:
        """Bring the tool onto an object along the facet's normal, and lift both straight up; then go on `ahead`.

        A level tool is turned up before it goes on.
        """
        carry, held = self.settings.carry, stage.held
        stage = self.motion.parked(stage, self.workcell.other(held.arm))
        T_world_tool = stage.T_world_objects[name] @ T_object_tool
        T_world_flange = T_world_tool @ self.traffic.T_tool_flange(held)
        normal = T_world_tool[:3, 2]
        above = StraightLeg(moved_by(T_world_flange, carry.descent * normal), -carry.descent * normal)
        lift = StraightLeg(T_world_flange, carry.lift * _UP)
        sucked = SuckedObject(name, inverse(T_object_tool))
        bare = replace(stage, T_world_tool=T_world_tool)
        laden = replace(bare, sucked=sucked)
        lifted = self._raised(laden)
        cup = self.traffic.close_pairs(bare, frozenset({TOOL_FRAME}))
        rest = self.traffic.close_pairs(laden, frozenset({TOOL_FRAME, name}))
        beside = self.traffic.close_pairs(lifted, lifted.carried)
        queries = [self.traffic.carrying(bare, cup), self.traffic.carrying(laden, rest)]
        ways = [(above, lift)]
        if turns := self._turns(lifted):
            queries.append(self.traffic.carrying(lifted, beside))
            ways = [(above, lift, turn) for turn in turns]
        visit, postures = self._choose(stage, ways, branches, queries)
        stage, posture = self.motion.arrive(stage, visit, postures, SegmentKind.TRANSFER, Onward(ahead, held))
        stage = self.motion.straight(stage, visit, 0, posture, SegmentKind.TRANSFER, cup)
        stage = self.switches.vacuum(replace(stage, sucked=sucked), SegmentKind.ATTACH)
        stage = self.motion.straight(stage, visit, 1, posture, SegmentKind.TRANSFER, rest)
        if turns:
            stage = self.motion.straight(stage, visit, 2, posture, SegmentKind.TRANSFER, beside)
        return stage

    def put_down(self, stage: ToolStage, T_world_goal: Transform, branches: int) -> ToolStage:
        """Bring tool and object over the goal, lower them, let go, and take the tool off along the facet's normal.

        A tool that is level there is turned level over the goal.
        """
        carry, held, sucked = self.settings.carry, stage.held, stage.sucked
        assert sucked is not None
        name = sucked.name
        stage = self.motion.parked(stage, self.workcell.other(held.arm))
        T_world_tool = T_world_goal @ inverse(sucked.T_tool_object)
        T_world_flange = T_world_tool @ self.traffic.T_tool_flange(held)
        lowered = StraightLeg(moved_by(T_world_flange, carry.lift * _UP), -carry.lift * _UP)
        leaving = StraightLeg(T_world_flange, carry.descent * T_world_tool[:3, 2])
        laden = replace(stage, T_world_tool=T_world_tool, T_world_objects={**stage.T_world_objects, name: T_world_goal})
        bare = replace(laden, sucked=None)
        over = self._raised(laden)
        rest = self.traffic.close_pairs(laden, frozenset({TOOL_FRAME, name}))
        cup = self.traffic.close_pairs(bare, frozenset({TOOL_FRAME}))
        beside = self.traffic.close_pairs(over, over.carried)
        queries = [self.traffic.carrying(laden, rest), self.traffic.carrying(bare, cup)]
        ways = [(lowered, leaving)]
        if turns := self._turns(over):
            queries.insert(0, self.traffic.carrying(over, beside))
            ways = [(turn.back(), lowered, leaving) for turn in turns]
        visit, postures = self._choose(stage, ways, branches, queries)
        home = self.motion.home(held.arm)
        stage, posture = self.motion.arrive(stage, visit, postures, SegmentKind.TRANSFER, home, beside)
        last = len(visit.legs) - 1
        if turns:
            stage = self.motion.straight(stage, visit, 0, posture, SegmentKind.TRANSFER, beside)
        stage = self.motion.straight(stage, visit, last - 1, posture, SegmentKind.TRANSFER, rest)
        stage = replace(self.switches.vacuum(stage, SegmentKind.DETACH), sucked=None)
        return self.motion.straight(stage, visit, last, posture, SegmentKind.TRANSFER, cup)

    def _raised(self, stage: ToolStage) -> ToolStage:
        """Return the stage with tool and object as far up as they are lifted."""
        assert stage.sucked is not None
        up, name = self.settings.carry.lift * _UP, stage.sucked.name
        objects = {**stage.T_world_objects, name: moved_by(stage.T_world_objects[name], up)}
        return replace(stage, T_world_tool=moved_by(stage.T_world_tool, up), T_world_objects=objects)

    def _turns(self, stage: ToolStage) -> list[TiltLeg]:
        """Return the turns that raise a level tool with its object, to be tried in order; none if it is not level."""
        carry, sucked = self.settings.carry, stage.sucked
        assert sucked is not None
        if tilt_of(stage.T_world_tool) <= carry.level:
            return []
        T_world_flange = stage.T_world_tool @ self.traffic.T_tool_flange(stage.held)
        body = next(body for body in self.workcell.objects if body.name == sucked.name)
        T_world_object = stage.T_world_objects[sucked.name]
        pivot = T_world_object[:3, :3] @ body.com + T_world_object[:3, 3]
        return [TiltLeg(T_world_flange, pivot, raising(stage.T_world_tool, tilt)) for tilt in carry.reliefs]

    def _choose(
        self, stage: ToolStage, ways: Sequence[tuple[Leg, ...]], branches: int, queries: Sequence[CollisionQuery]
    ) -> tuple[Visit, list[Posture]]:
        """Return the first of several visits that has postures free of collision, and these."""
        *earlier, last = (Visit(self.motion.arm(stage.held.arm), way) for way in ways)
        for visit in earlier:
            with suppress(Stuck):
                return visit, self.motion.choose(stage, visit, branches, queries)
        return last, self.motion.choose(stage, last, branches, queries)

    def hand_over(
        self, stage: ToolStage, receiver: HeldGrasp, places: Sequence[HandoverPlace], ahead: Array
    ) -> ToolStage:
        """Bring the tool to a handover place, let the other arm take it there, and park the arm that gave it.

        The receiver goes on `ahead` (k, 6). Places are tried in the order given until the budget of motions is spent.
        """
        stage = self.motion.parked(stage, receiver.arm)
        reasons: Counter[Rejection] = Counter()
        moved = 0
        for place in places:
            if moved >= self.settings.orientations:
                break
            try:
                exchange = Exchange(self.motion, self.switches, stage, receiver, place)
                moved += 1
                return exchange.realise(Onward(ahead, receiver))
            except Stuck as stuck:
                reasons[stuck.rejection] += 1
        raise Stuck(commonest(reasons, Rejection("handover", "no place is known for the two grasps")))
