"""The story of objects moved with a suction tool."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from app.summary import failure_of
from app.viewer.curves import Chart, Span
from app.viewer.kind_story import KindStory, squeeze_words, stretch
from app.viewer.timeline import Timeline
from app.viewer.tool_curves import largest_share, largest_squeeze, overloads, planned_charts, simulated_charts
from planners.scene.suction_tool import TOOL_NAME

TOOL_OUTCOMES = {
    "done": "done",
    "object_dropped": "object dropped",
    "tool_slipped": "tool slipped",
    "toppled": "toppled",
    "off_goal": "off its goal",
}
TOOL_WORDS = {"long_symmetric": "long tool", "short_asymmetric": "short tool"}


class ToolStory(KindStory):
    """Objects one after the other: the tool is taken, put on the object, carried with it, and taken off."""

    tabs = ("View", "Regrasp", "Physics", "Figures", "Checks")
    simulation_words = "Simulation"
    meanings = ("left", "right", "environment", "suction", "limit", "start", "goal")

    def subtitle(self) -> str:
        """Say how many objects are moved, and with which tool."""
        task = self.document["task"]
        tool = TOOL_WORDS.get(task["tool"], task["tool"]) if isinstance(task["tool"], str) else "custom tool"
        count = len(task["objects"])
        masses = sorted({item["mass"] for item in task["objects"]})
        mass = f"{masses[0]:g} kg" if len(masses) == 1 else f"{masses[0]:g} to {masses[-1]:g} kg"
        return f"{count} object{'s' if count > 1 else ''} of {mass}, {tool}"

    def segments(self) -> list[dict[str, Any]]:
        """Return the plan's segments; their state is the object that they are about."""
        segments = self.document["segments"]
        subjects = subjects_of(segments)
        return [
            stretch(
                segment["kind"],
                segment["time"],
                _capitalised(_deed(segments, index, subjects[index])),
                _plain(subjects[index] or ""),
                _hold(segment),
            )
            for index, segment in enumerate(segments)
        ]

    def highlights(self) -> list[list[str]]:
        """Return handovers, finger force, and use of the cup."""
        force, arm = largest_squeeze(self.document)
        share = largest_share(self.document)
        handovers = sum(segment["kind"] == "handover" for segment in self.document["segments"])
        rows = [["handovers", str(handovers)], ["largest finger force", f"{force:.0f} N ({arm})"]]
        return rows if share is None else [*rows, ["cup used", f"{100.0 * share:.0f} %"]]

    def planned_charts(self, timeline: Timeline) -> list[Chart]:
        """Return use of the cup, finger forces, reserve, and joint speeds."""
        return planned_charts(self.document, timeline)

    def simulated_charts(self) -> list[Chart]:
        """Return use of the cup, squeeze of both hands, and distances from the plan."""
        return simulated_charts(self.document)

    def after_the_plan(self, planned_end: float) -> Sequence[tuple[str, float, float, str]]:
        """Return that the robot stands still."""
        return [("still", planned_end, self.document["simulation"]["time"], "Robot stands still")]

    def pages(self) -> Sequence[Span]:
        """Return the whole."""
        return [(0.0, self.document["simulation"]["time"])]

    def marked(self) -> Sequence[Span]:
        """Return when the cup was asked for more than it bears."""
        return overloads(self.document)

    def tell_simulation(self) -> dict[str, Any]:
        """Return how it ended, how far the objects are from their goals, and what was modelled."""
        simulation = self.document["simulation"]
        return {
            "outcome": simulation["outcome"],
            "words": TOOL_OUTCOMES[simulation["outcome"]],
            "good": simulation["outcome"] == "done",
            "sentence": _sentence(simulation),
            "figures": _figures(simulation),
            "nodes": [],
            "model": simulation["model"],
        }


def subjects_of(segments: Sequence[Mapping[str, Any]]) -> list[str | None]:
    """Return which object each segment is about: the next one on the cup, or the last one while the cup leaves it."""
    subjects: list[str | None] = [None] * len(segments)
    following = None
    for index in range(len(segments) - 1, -1, -1):
        following = sucked(segments, index) or following
        subjects[index] = following
    last = None
    for index in range(len(segments)):
        leaves = index > 0 and segments[index - 1]["kind"] == "detach"
        if subjects[index] is None or leaves:
            subjects[index] = last
        last = subjects[index]
    return subjects


def sucked(segments: Sequence[Mapping[str, Any]], index: int) -> str | None:
    """Return what is on the cup in a segment, in which the vacuum comes or goes too."""
    beside = {"attach": index + 1, "detach": index - 1}.get(segments[index]["kind"], index)
    if not 0 <= beside < len(segments):
        return None
    riders = segments[beside]["attached"].items()
    return next((name for name, rides in riders if any(ride["to"] == TOOL_NAME for ride in rides)), None)


def _deed(segments: Sequence[Mapping[str, Any]], index: int, subject: str | None) -> str:
    """Return what happens in a segment, in words."""
    segment = segments[index]
    what = "the object" if subject is None else _plain(subject)
    kind, hold = segment["kind"], segment["hold"]
    if kind == "transfer":
        return _carrying(segments, index, what)
    if not segment["movers"] and kind == "transit":
        return _fingers(segment)
    grip = None if hold is None or kind not in ("grip", "release") else hold["grip"]
    arm = " and ".join(segment["movers"]) if grip is None else grip["arm"]
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
    }[kind]


def _carrying(segments: Sequence[Mapping[str, Any]], index: int, what: str) -> str:
    kinds = [segments[i]["kind"] if 0 <= i < len(segments) else "" for i in (index - 1, index + 1)]
    hand = f"{' and '.join(segments[index]['movers'])} hand"
    if sucked(segments, index) is None:
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


def _fingers(segment: Mapping[str, Any]) -> str:
    """Return which free hand opens or closes its fingers while nothing else moves."""
    for arm, widths in segment["gripper_width"].items():
        if widths[0] != widths[-1]:
            return f"{arm} hand {'opens' if widths[-1] > widths[0] else 'closes'} its fingers"
    return "robot waits"


def _handed_over_next(segments: Sequence[Mapping[str, Any]], index: int) -> bool:
    """Tell whether the other hand takes the tool before this one moves it again."""
    following = (segment["kind"] for segment in segments[index + 1 :])
    return next((kind == "grip" for kind in following if kind in ("transfer", "attach", "grip")), False)


def _hold(segment: Mapping[str, Any]) -> str:
    hold = segment["hold"] or {}
    grips = [grip for grip in (hold.get("grip"), hold.get("second_grip")) if grip is not None]
    if not grips:
        return "tool at rest"
    where = "in both hands" if len(grips) > 1 else f"in the {grips[0]['arm']} hand"
    return f"tool {where}{squeeze_words(grips)}"


def _sentence(simulation: Mapping[str, Any]) -> str:
    if simulation["outcome"] == "done":
        worst = max((error["distance"] for error in simulation["goals"].values()), default=0.0)
        return f"All objects are within {1e3 * worst:.1f} mm of their goals."
    failed_at, cause = failure_of(simulation)
    return f"At {failed_at:.2f} s: {cause}."


def _figures(simulation: Mapping[str, Any]) -> list[dict[str, Any]]:
    goals = [
        [_plain(name), f"{1e3 * error['distance']:.1f} mm", f"{np.degrees(error['angle']):.1f}\u00b0"]
        for name, error in simulation["goals"].items()
    ]
    largest = simulation["largest"]
    rows = [
        ["cup used, most", f"{100.0 * largest['suction_share']:.0f} %"],
        ["squeeze needed, most", f"{largest['squeeze']:.0f} N"],
        ["tool off its plan, most", f"{1e3 * largest['tool_off_plan']:.1f} mm"],
        ["object off its plan, most", f"{1e3 * largest['object_off_plan']:.1f} mm"],
    ]
    return [{"title": "Off the goal at the end", "rows": goals}, {"title": "On the way", "rows": rows}]


def _plain(name: str) -> str:
    return name.replace("_", " ")


def _capitalised(words: str) -> str:
    return words[0].upper() + words[1:]
