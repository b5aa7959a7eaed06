"""What happens while no joint moves: fingers close and open, and the vacuum goes on and off."""

from __future__ import annotations

from dataclasses import dataclass, replace

from planners.graph.rejections import Rejection
from planners.hands.arm_motion import Stuck, touching
from planners.regrasp.motion.scene_state import HeldGrasp, SceneState, SegmentWriter
from planners.regrasp.motion.state_queries import StateQueries
from planners.regrasp.motion.tool_motion import TOUCH
from planners.regrasp.statics.hold_statics import HoldStatics
from planners.regrasp.tool_settings import ToolPace
from planners.segment import SegmentKind


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
