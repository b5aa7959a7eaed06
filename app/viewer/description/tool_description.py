"""What the page tells of objects moved with a suction tool: it is taken, put on each, carried with it, taken off."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from app.viewer.description.charts import MILLIMETRES, PERCENT, cup_shares
from app.viewer.description.plan_description import (
    FigureGroup,
    KindDescription,
    Row,
    SegmentDescription,
    SimulationDescription,
    plain,
    squeeze_words,
)
from app.viewer.playback import objects_of_segments
from planners.contract.task_spec import SuctionToolTask
from planners.plan.plan import Plan
from planners.plan.segment import Segment, riding_on
from planners.plan.simulation import ToolSimulation, failure_of
from planners.scene.suction_tool import TOOL_NAME

OUTCOMES = {
    "done": "done",
    "object_dropped": "object dropped",
    "tool_slipped": "tool slipped",
    "toppled": "toppled",
    "off_goal": "off its goal",
}
TOOL_WORDS: Mapping[str, str] = {
    "carton_lifter": "tool for cartons",
    "long_symmetric": "long tool",
    "long_symmetric_large_pad": "long tool with the large pad",
    "short_asymmetric": "short tool",
}


class ToolDescription(KindDescription):
    """Of a plan that moves objects one after the other."""

    tabs = ("View", "Segments", "Regrasp", "Physics", "Figures", "Checks")
    simulation_words = "Simulation"
    meanings = ("left", "right", "environment", "suction", "limit", "start", "goal")

    @property
    def _simulation(self) -> ToolSimulation:
        assert isinstance(self.plan.simulation, ToolSimulation)
        return self.plan.simulation

    def subtitle(self) -> str:
        """Say how many objects are moved, and with which tool."""
        task = self.plan.task
        assert isinstance(task, SuctionToolTask)
        # One that the cell brings has no words but its name.
        tool = TOOL_WORDS.get(task.tool, f"tool {plain(task.tool)}") if isinstance(task.tool, str) else "custom tool"
        count = len(task.objects)
        masses = sorted({item.mass for item in task.objects})
        mass = f"{masses[0]:g} kg" if len(masses) == 1 else f"{masses[0]:g} to {masses[-1]:g} kg"
        return f"{count} object{'s' if count > 1 else ''} of {mass}, {tool}"

    def segments(self) -> list[SegmentDescription]:
        """Return the plan's segments; their state is the object that they are about."""
        segments = self.plan.segments
        described = []
        for index, (segment, name) in enumerate(zip(segments, objects_of_segments(segments), strict=True)):
            words = _action(segments, index, name)
            described.append(
                SegmentDescription(
                    kind=segment.kind,
                    start=float(segment.time[0]),
                    end=segment.end,
                    words=words[0].upper() + words[1:],
                    state=plain(name or ""),
                    hold=_hold(segment),
                )
            )
        return described

    def highlights(self) -> list[Row]:
        """Return handovers, finger force, and use of the cup."""
        force, arm = _largest_squeeze(self.plan)
        share = max((share for _, share in cup_shares(self.plan)), default=None)
        handovers = sum(segment.kind == "handover" for segment in self.plan.segments)
        rows: list[Row] = [("handovers", str(handovers)), ("largest finger force", f"{force:.0f} N ({arm})")]
        return rows if share is None else [*rows, ("cup used", f"{PERCENT * share:.0f} %")]

    def after_the_plan(self) -> Sequence[tuple[str, float, float, str]]:
        """Return one span, named, in which the robot stands still [s]."""
        return [("still", self.plan.duration, self._simulation.time, "Robot stands still")]

    def pages(self) -> Sequence[tuple[float, float]]:
        """Return the whole."""
        return [(0.0, self._simulation.time)]

    def simulation(self) -> SimulationDescription:
        """Return how it ended, how far the objects are from their goals, and what was modelled."""
        simulation = self._simulation
        return SimulationDescription(
            outcome=simulation.outcome,
            words=OUTCOMES[simulation.outcome],
            good=simulation.outcome == "done",
            sentence=_sentence(simulation),
            figures=_figures(simulation),
            nodes=[],
            model=simulation.model,
        )


def _action(segments: Sequence[Segment], index: int, subject: str | None) -> str:
    """Return what happens in a segment, in words."""
    segment = segments[index]
    what = "the object" if subject is None else plain(subject)
    if segment.kind == "transfer":
        return _carrying(segments, index, what)
    if not segment.movers and segment.kind == "transit":
        return _fingers(segment)
    taking = [grip.arm for grip in segment.grips[:1] if segment.kind in ("grip", "release")]
    arm = " and ".join(taking or segment.movers)
    hand = f"{arm} hand" if arm in ("left", "right") else "both hands" if arm else ""
    return {
        "transit": f"{hand} travels",
        "approach": f"{hand} approaches the tool",
        "retreat": f"{hand} leaves the tool",
        "grip": f"{hand} takes the tool",
        "release": f"{hand} lets the tool go",
        "handover": "both hands hold the tool",
        "attach": f"vacuum on: the cup takes {what}",
        "detach": f"vacuum off: the cup lets {what} go",
    }[segment.kind]


def _carrying(segments: Sequence[Segment], index: int, what: str) -> str:
    kinds = [segments[i].kind if 0 <= i < len(segments) else "" for i in (index - 1, index + 1)]
    hand = f"{' and '.join(segments[index].movers)} hand"
    if riding_on(TOOL_NAME, segments, index) is None:
        if kinds[1] == "attach":
            return f"{hand} puts the cup on {what}"
        if kinds[0] == "detach":
            return f"{hand} takes the cup off {what}"
        if kinds[0] == "grip":
            return f"{hand} lifts the tool out of its rest"
        if _handed_over_next(segments, index):
            return f"{hand} holds the tool out to the other hand"
        return f"{hand} carries the tool to {what}"
    if kinds[0] == "attach":
        return f"{hand} lifts {what}"
    if kinds[1] == "detach":
        return f"{hand} puts {what} down"
    if _handed_over_next(segments, index):
        return f"{hand} holds the tool with {what} out to the other hand"
    return f"{hand} carries the tool with {what}"


def _fingers(segment: Segment) -> str:
    """Return which free hand opens or closes its fingers while nothing else moves."""
    for arm, widths in segment.gripper_width.items():
        if widths[0] != widths[-1]:
            return f"{arm} hand {'opens' if widths[-1] > widths[0] else 'closes'} its fingers"
    return "robot waits"


def _handed_over_next(segments: Sequence[Segment], index: int) -> bool:
    """Tell whether the other hand takes the tool before this one moves it again."""
    following = (segment.kind for segment in segments[index + 1 :])
    return next((kind == "grip" for kind in following if kind in ("transfer", "attach", "grip")), False)


def _hold(segment: Segment) -> str:
    grips = segment.grips
    if not grips:
        return "tool at rest"
    first, *others = grips
    where = "in both hands" if others else f"in the {first.arm} hand"
    return f"tool {where}{squeeze_words(grips)}"


def _largest_squeeze(plan: Plan) -> tuple[float, str]:
    """Return the most that a finger presses with [N], and which arm's it is."""
    pressed = (
        (float(contact.wrench[:3] @ contact.normal), contact.by)
        for contact_set in plan.timeline.contact_sets
        for contact in contact_set.contacts
        if contact.by in plan.cell.arms
    )
    return max(pressed, default=(0.0, "no hand"))


def _sentence(simulation: ToolSimulation) -> str:
    failure = failure_of(simulation)
    if failure is None:
        worst = max((error.distance for error in simulation.goals.values()), default=0.0)
        return f"All objects are within {MILLIMETRES * worst:.1f} mm of their goals."
    return f"At {failure.time:.2f} s: {failure.cause}."


def _figures(simulation: ToolSimulation) -> list[FigureGroup]:
    goals = [
        (plain(name), f"{MILLIMETRES * error.distance:.1f} mm", f"{np.degrees(error.angle):.1f}\u00b0")
        for name, error in simulation.goals.items()
    ]
    largest = simulation.largest
    rows: list[Row] = [
        ("cup used, most", f"{PERCENT * largest.suction_share:.0f} %"),
        ("squeeze needed, most", f"{largest.squeeze:.0f} N"),
        ("tool off its plan, most", f"{MILLIMETRES * largest.tool_off_plan:.1f} mm"),
        ("object off its plan, most", f"{MILLIMETRES * largest.object_off_plan:.1f} mm"),
    ]
    return [FigureGroup(title="Off the goal at the end", rows=[*goals]), FigureGroup(title="On the way", rows=rows)]
