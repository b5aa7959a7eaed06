"""What happens while no joint moves: fingers close and open, and the vacuum goes on and off."""

from __future__ import annotations

from dataclasses import dataclass, replace

from planners.graph.rejections import Rejection
from planners.regrasp.motion.tool_motion import Stuck
from planners.regrasp.motion.tool_queries import ToolTraffic
from planners.regrasp.motion.tool_stage import HeldGrasp, StageWriter, ToolStage
from planners.regrasp.statics.hold_statics import HoldStatics
from planners.regrasp.tool_settings import ToolPace
from planners.segment import SegmentKind


@dataclass(frozen=True, eq=False)
class ToolSwitches:
    """Fingers and vacuum of one scene; each step leads from one stage to the next, or raises `Stuck`."""

    traffic: ToolTraffic
    writer: StageWriter
    statics: HoldStatics
    pace: ToolPace

    def shaped(self, stage: ToolStage, held: HeldGrasp) -> ToolStage:
        """Open an empty hand as wide as a grasp wants it on the way to the tool."""
        width = float(self.traffic.grasps.open_widths[held.grasp])
        if stage.widths[held.arm] == width:
            return stage
        shaped = self.writer.still(stage, SegmentKind.TRANSIT, self.pace.finger_time, {held.arm: width})
        query = self.traffic.hand(shaped, held.arm)
        pair = int(query.first_collision(shaped.q[None])[0])
        if pair >= 0:
            touch = "{} and {} would touch".format(*query.pair_names(pair))
            raise Stuck(Rejection("transit", f"{touch} while the {held.arm} hand opens"))
        return shaped

    def gripped(self, stage: ToolStage, held: HeldGrasp) -> ToolStage:
        """Close a hand on the tool; it holds it alone, or together with the hand that gives it."""
        holds = [held] if stage.holder is None else [held, stage.holder]
        width = {held.arm: float(self.traffic.grasps.widths[held.grasp])}
        stage = self.writer.still(stage, SegmentKind.GRIP, self.pace.finger_time, width, holds)
        return replace(stage, holder=stage.holder or held)

    def released(self, stage: ToolStage, receiver: HeldGrasp) -> ToolStage:
        """Hold the tool in both hands for a moment, then open the one that gives it."""
        giver = stage.held
        pace = self.pace
        stage = self.writer.still(stage, SegmentKind.HANDOVER, pace.handover_time, {}, [giver, receiver])
        width = {giver.arm: float(self.traffic.grasps.open_widths[giver.grasp])}
        stage = self.writer.still(stage, SegmentKind.RELEASE, pace.finger_time, width, [giver, receiver])
        return replace(stage, holder=receiver)

    def vacuum(self, stage: ToolStage, kind: SegmentKind) -> ToolStage:
        """Turn the vacuum on or off; the object stands while that lasts."""
        after = self.writer.still(stage, kind, self.pace.vacuum_time, {})
        rejection = self.statics.worst(after.segments[-1], stage.places).rejection
        if rejection is not None:
            raise Stuck(rejection)
        return after
