"""The curves of a suction-tool plan: what cup and fingers are asked for, against what they bear."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from app.viewer.curves import (
    MILLIMETRES,
    PERCENT,
    Chart,
    Series,
    Span,
    has_curves,
    level,
    reserves,
    simulated_curves,
    spans,
    speeds,
    times,
)
from app.viewer.timeline import ContactSet, Timeline
from planners.geometry.pose import Array
from planners.regrasp.suction.suction_hold import suction_margin
from planners.scene.suction_tool import TOOL_NAME, CupData

CUP_TITLE = "Suction cup, used of what it bears"
FORCE_TITLE, SQUEEZE_TITLE = "Finger force", "Finger squeeze needed"


def planned_charts(document: Mapping[str, Any], timeline: Timeline) -> list[Chart]:
    """Return use of the cup, finger forces, reserve, and joint speeds; nothing without segments."""
    if not document["segments"]:
        return []
    sets = timeline.contact_sets
    forces = [_cup(document), _forces(document, sets)] if sets else []
    charts = [*forces, reserves(document), speeds(document)]
    return [chart for chart in charts if chart is not None]


def simulated_charts(document: Mapping[str, Any]) -> list[Chart]:
    """Return use of the cup, squeeze of both hands, and distances from the plan; nothing without a simulation."""
    simulation = document["simulation"]
    if not has_curves(simulation):
        return []
    time, curves = simulated_curves(simulation)
    share = PERCENT * _while_held(curves["suction share"])
    cup = (Series("used", "suction", share), level("limit", PERCENT, time))
    squeezes = [Series(arm, arm, _while_held(curves[f"{arm} squeeze"])) for arm in document["cell"]["arms"]]
    squeezes.append(level("commanded", _commanded(document), time))
    off = (
        Series("tool", "sum", MILLIMETRES * curves["tool off plan"]),
        Series("object", "suction", MILLIMETRES * curves["object off plan"]),
    )
    return [
        Chart(CUP_TITLE, "%", time, cup, overloads(document)),
        Chart(SQUEEZE_TITLE, "N", time, tuple(squeezes)),
        Chart("Distance from the plan", "mm", time, off),
    ]


def overloads(document: Mapping[str, Any]) -> tuple[Span, ...]:
    """Return when in the simulation the cup was asked for more than it bears."""
    if not has_curves(document["simulation"]):
        return ()
    time, curves = simulated_curves(document["simulation"])
    return spans(time, curves["suction share"] > 1.0)


def largest_share(document: Mapping[str, Any]) -> float | None:
    """Return the largest use of the cup, of what it bears [1]; None where it holds nothing."""
    return max((share for _, share in _shares(document)), default=None)


def _cup(document: Mapping[str, Any]) -> Chart | None:
    shares = list(_shares(document))
    if not shares:
        return None
    time = np.array([time for time, _ in shares])
    # A line breaks where nothing is on the cup: between two objects.
    values = PERCENT * np.array([share for _, share in shares])
    gap = np.flatnonzero(np.diff(time) > 1.0)
    time = np.insert(time, gap + 1, time[gap] + 1e-3)
    values = np.insert(values, gap + 1, np.nan)
    return Chart(CUP_TITLE, "%", time, (Series("used", "suction", values), level("limit", PERCENT, time)))


def _shares(document: Mapping[str, Any]) -> list[tuple[float, float]]:
    """Return time [s] and use of the cup [1] at every sample at which it holds an object."""
    return [
        (segment["time"][contact["sample"]], _share(contact))
        for segment in document["segments"]
        for contact in segment["contacts"]
        if contact["kind"] == "suction" and contact["by"] == TOOL_NAME
    ]


def _share(contact: Mapping[str, Any]) -> float:
    """Return how much a contact uses of what its cup bears, by the limit that is nearest [1]."""
    outward, x = -np.array(contact["normal"]), np.array(contact["x_axis"])
    axes = np.column_stack([x, np.cross(outward, x), outward])
    wrench = np.array(contact["wrench"]).reshape(2, 3) @ axes
    cup = CupData(contact["radius"], contact["limit"], contact["mu"], contact["kappa"])
    return 1.0 - float(suction_margin(wrench.reshape(6), cup))


def _commanded(document: Mapping[str, Any]) -> float:
    """Return the squeeze of the plan's grips; of a document of before it was stated, the limit of a finger [N]."""
    grips = (segment["hold"]["grip"] for segment in document["segments"] if segment["hold"] is not None)
    stated = (grip.get("squeeze") for grip in grips if grip is not None)
    return next((squeeze for squeeze in stated if squeeze is not None), document["task"]["grip_force_limit"])


def largest_squeeze(document: Mapping[str, Any]) -> tuple[float, str]:
    """Return the most that a finger presses with [N], and which arm's it is."""
    pressed = (
        (float(np.dot(contact["wrench"][:3], contact["normal"])), contact["by"])
        for segment in document["segments"]
        for contact in segment["contacts"]
        if contact["by"] in document["cell"]["arms"]
    )
    return max(pressed, default=(0.0, "no hand"))


def _forces(document: Mapping[str, Any], sets: tuple[ContactSet, ...]) -> Chart:
    time = times(sets)
    series = [Series(arm, arm, _normals(sets, arm)) for arm in document["cell"]["arms"]]
    limit = level("limit", document["task"]["grip_force_limit"], time)
    return Chart(FORCE_TITLE, "N", time, (*series, limit))


def _normals(sets: tuple[ContactSet, ...], arm: str) -> Array:
    """Return the greater normal force of a hand's fingers at each set; nan where it holds nothing."""
    return np.array([max((float(t.force @ t.normal) for t in s.touches if t.by == arm), default=np.nan) for s in sets])


def _while_held(values: Array) -> Array:
    """Return a curve with gaps where it is zero: nothing is held there."""
    return np.where(values == 0.0, np.nan, values)
