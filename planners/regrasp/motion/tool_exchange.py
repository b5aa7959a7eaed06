"""What happens where the tool changes hands, and while no joint moves: fingers close and open, the vacuum goes on."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace

from planners.collision.model import CollisionQuery
from planners.geometry.pose import Transform
from planners.graph.rejections import Rejection
from planners.hands.arm_motion import Stuck, among_all, touching
from planners.plan.segment import SegmentKind
from planners.regrasp.motion.cartesian_path import CartesianPath, Onward, Posture
from planners.regrasp.motion.scene_state import HeldGrasp, SceneState, SegmentWriter
from planners.regrasp.motion.state_queries import StateQueries
from planners.regrasp.motion.tool_motion import TOUCH, ToolMotion, commonest
from planners.regrasp.statics.hold_statics import HoldStatics
from planners.regrasp.tool_settings import ToolPace


@dataclass(frozen=True, eq=False)
class ToolSwitches:
    """Fingers and vacuum of one scene; each step leads from one state to the next, or raises `Stuck`."""

    queries: StateQueries
    writer: SegmentWriter
    statics: HoldStatics
    pace: ToolPace

    def shaped(self, state: SceneState, held: HeldGrasp) -> SceneState:
        """Open an empty hand as wide as a grasp wants it on the way to the tool."""
        width = float(self.queries.grasps.open_widths[held.grasp])
        if state.widths[held.arm] == width:
            return state
        shaped = self.writer.still(state, SegmentKind.TRANSIT, self.pace.finger_time, {held.arm: width})
        names = touching(self.queries.hand(shaped, held.arm), shaped.q[None])
        if names is not None:
            touch = TOUCH.format(*names)
            raise Stuck(Rejection("transit", f"{touch} while the {held.arm} hand opens"))
        return shaped

    def gripped(self, state: SceneState, held: HeldGrasp) -> SceneState:
        """Close a hand on the tool; it holds it alone, or together with the hand that gives it."""
        holds = [held] if state.holder is None else [held, state.holder]
        width = {held.arm: float(self.queries.grasps.widths[held.grasp])}
        state = self.writer.still(state, SegmentKind.GRIP, self.pace.finger_time, width, holds)
        return replace(state, holder=state.holder or held)

    def released(self, state: SceneState, receiver: HeldGrasp) -> SceneState:
        """Hold the tool in both hands for a moment, then open the one that gives it."""
        giver = state.held
        pace = self.pace
        state = self.writer.still(state, SegmentKind.HANDOVER, pace.handover_time, {}, [giver, receiver])
        width = {giver.arm: float(self.queries.grasps.open_widths[giver.grasp])}
        state = self.writer.still(state, SegmentKind.RELEASE, pace.finger_time, width, [giver, receiver])
        return replace(state, holder=receiver)

    def vacuum(self, state: SceneState, kind: SegmentKind) -> SceneState:
        """Turn the vacuum on or off; the object stands while that lasts."""
        after = self.writer.still(state, kind, self.pace.vacuum_time, {})
        rejection = self.statics.worst(after.segments[-1], state.places).rejection
        if rejection is not None:
            raise Stuck(rejection)
        return after


@dataclass(frozen=True, eq=False)
class HandoverPlace:
    """A pose of the tool at which it can change hands, and the branches both arms may use there, as bit sets."""

    T_world_tool: Transform
    giver: int
    receiver: int


class Exchange:
    """The tool changes hands at one place: which postures of both arms go together there, and the motion."""

    def __init__(
        self, motion: ToolMotion, switches: ToolSwitches, state: SceneState, receiver: HeldGrasp, place: HandoverPlace
    ) -> None:
        """Find the postures.

        Raises:
            Stuck: no two postures go together.
        """
        giver = state.held
        self.motion, self.switches, self.state, self.giver, self.receiver = motion, switches, state, giver, receiver
        queries, T = motion.queries, place.T_world_tool
        self.give = CartesianPath(motion.arm(giver.arm), (motion.retreat(T @ queries.T_tool_flange(giver)),))
        self.take = CartesianPath(motion.arm(receiver.arm), (motion.approach(T @ queries.T_tool_flange(receiver)),))
        grasps = queries.grasps
        opened = {giver.arm: float(grasps.open_widths[giver.grasp])}
        opened[receiver.arm] = float(grasps.open_widths[receiver.grasp])
        closed = {giver.arm: float(grasps.widths[giver.grasp]), receiver.arm: float(grasps.widths[receiver.grasp])}
        at_place = replace(state, T_world_tool=T)
        coming = replace(at_place, widths={**closed, receiver.arm: opened[receiver.arm]})
        both = replace(at_place, widths=closed)
        leaving = replace(at_place, widths={**closed, giver.arm: opened[giver.arm]}, holder=receiver)
        self.pairs = self._pairs(
            place,
            queries.hand(coming, receiver.arm, around=True),
            queries.everything(both, [giver.arm, receiver.arm]),
            queries.hand(leaving, giver.arm, around=True),
        )

    def realise(self, onward: Onward) -> SceneState:
        """Plan all motion of the exchange; the receiver goes onward from there.

        Raises:
            Stuck: some of it was not found.
        """
        motion, switches = self.motion, self.switches
        givers = list(dict.fromkeys(giver for giver, _ in self.pairs))
        state, giving = motion.arrive(self.state, self.give, givers, SegmentKind.TRANSFER, motion.home(self.giver.arm))
        state = switches.shaped(state, self.receiver)
        takers = [taker for giver, taker in self.pairs if giver.branch == giving.branch]
        state, taking = motion.arrive(state, self.take, takers, SegmentKind.TRANSIT, onward)
        state = motion.straight(state, self.take, 0, taking, SegmentKind.APPROACH)
        state = switches.gripped(state, self.receiver)
        state = switches.released(state, self.receiver)
        state = motion.straight(state, self.give, 0, giving, SegmentKind.RETREAT)
        return motion.parked(state, self.giver.arm)

    def _pairs(
        self, place: HandoverPlace, coming: CollisionQuery, both: CollisionQuery, leaving: CollisionQuery
    ) -> list[tuple[Posture, Posture]]:
        """Return the pairs of postures with which the receiver can come, both can hold, and the giver can leave."""
        carry, cell = self.motion.settings.carry, self.motion.workcell
        givers = list(self.give.postures(place.giver, carry.step, carry.continuity))
        takers = list(self.take.postures(place.receiver, carry.step, carry.continuity))
        if not givers or not takers:
            raise Stuck(Rejection("handover", "an arm cannot follow the straight way to the tool or off it"))
        reasons: Counter[Rejection] = Counter()
        pairs = []
        for giver in givers:
            for taker in takers:
                q = among_all(self.state.q, cell.joints(self.giver.arm), giver.start[None])[0]
                come = among_all(q, cell.joints(self.receiver.arm), taker.ways[0])
                leave = among_all(come[-1], cell.joints(self.giver.arm), giver.ways[0])
                ways = ((both, come[-1:]), (coming, come), (leaving, leave))
                touches = (self.motion.touch(query, Q) for query, Q in ways)
                touch = next((each for each in touches if each is not None), None)
                if touch is None:
                    pairs.append((giver, taker))
                else:
                    reasons[Rejection("handover", f"{touch} while the tool changes hands")] += 1
        if not pairs:
            raise Stuck(commonest(reasons, Rejection("handover", "no two postures go together")))
        return pairs
