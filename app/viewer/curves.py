"""The curves of a plan: what the hands and the cup bear, how fast the joints turn, and what the simulation felt."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from app.viewer.timeline import ContactSet, Timeline, Touch
from planners.geometry.pose import Array

MINIMUM = "min. m g \u2212 f_cup"
MILLIMETRES = 1e3
Span = tuple[float, float]
"""Begin and end [s]."""


@dataclass(frozen=True, eq=False)
class Series:
    """One line of a chart."""

    name: str
    colour: str
    """A meaning of the palette."""
    values: Array
    """(n,) at the chart's times; nan where there is nothing to draw."""
    dashed: bool = False


@dataclass(frozen=True, eq=False)
class Chart:
    """Lines over a common time."""

    title: str
    unit: str
    time: Array
    """(n,) [s]; two values at one time where two segments meet."""
    series: tuple[Series, ...]
    marked: tuple[Span, ...] = ()
    """Times at which something is not as it should be."""


def planned_charts(document: Mapping[str, Any], timeline: Timeline) -> list[Chart]:
    """Return vertical forces of the hands, suction load and joint speeds; nothing for a plan without segments."""
    if not document["segments"]:
        return []
    charts = [_hand_forces(document, timeline.contact_sets), _suction(timeline.contact_sets), _speeds(document)]
    return [chart for chart in charts if chart is not None]


def simulated_charts(document: Mapping[str, Any]) -> list[Chart]:
    """Return what the simulated hands, cup and lifter did; nothing for a plan without one."""
    simulation = document["simulation"]
    if simulation is None or not simulation["force_curves"][0]["time"]:
        return []
    curves = {curve["name"]: np.array(curve["value"], dtype=float) for curve in simulation["force_curves"]}
    time = np.array(simulation["force_curves"][0]["time"], dtype=float)
    gripping, pushing = (arm_with(document, kind) for kind in ("gripper", "stick"))

    def level(name: str, value: float) -> Series:
        return Series(name, "limit", np.full(len(time), value), dashed=True)

    hands = [
        Series(f"{pushing}, pushes", pushing, curves["pushing hand"]),
        Series(f"{gripping}, grips", gripping, curves["gripping hand"]),
        Series("both", "sum", curves["both hands"]),
    ]
    if simulation["minimum_total_force"] is not None:
        hands.append(level(MINIMUM, simulation["minimum_total_force"]))
    cup = (Series("load", "suction", curves["suction load"]), level("limit", document["task"]["cup"]["max_force"]))
    speeds = (
        Series("hands, commanded", "sum", MILLIMETRES * curves["commanded velocity"]),
        Series("lifter", "suction", MILLIMETRES * curves["lifter velocity"]),
    )
    return [
        Chart("Hands, vertical force", "N", time, tuple(hands), dips(document)),
        Chart("Vacuum cup", "N", time, cup),
        Chart("Lift, speed upward", "mm/s", time, speeds),
        Chart("Plate, tilt", "\u00b0", time, (Series("tilt", "environment", curves["plate tilt"]),)),
    ]


def dips(document: Mapping[str, Any]) -> tuple[Span, ...]:
    """Return when both hands together bore less than the minimum during the simulated lift."""
    simulation = document["simulation"]
    least, lift = simulation["minimum_total_force"], simulation["lift"]
    if least is None or lift is None:
        return ()
    both = next(curve for curve in simulation["force_curves"] if curve["name"] == "both hands")
    time, total = np.array(both["time"]), np.array(both["value"])
    below = (total < least) & (time >= lift["begin"])
    # A dip ends with the first sample that is no longer below.
    borders = np.flatnonzero(np.diff(np.concatenate([[False], below, [False]]).astype(int)))
    times = time[np.minimum(borders, len(time) - 1)]
    return tuple((float(begin), float(end)) for begin, end in times.reshape(-1, 2))


def arm_with(document: Mapping[str, Any], kind: str) -> str:
    """Return the arm whose hand is of a kind."""
    return next(arm for arm, hand in document["cell"]["hands"].items() if hand["kind"] == kind)


def minimum_total_force(document: Mapping[str, Any]) -> float | None:
    """Return what the hands must bear at least of a plate, m g - f_cup, once nothing else touches it [N]."""
    task = document["task"]
    if task["kind"] != "plate_lift":
        return None
    gravity = float(np.linalg.norm(document["cell"]["gravity"]))
    return task["plate"]["mass"] * gravity - task["cup"]["max_force"]


def _hand_forces(document: Mapping[str, Any], sets: tuple[ContactSet, ...]) -> Chart | None:
    arms = tuple(document["cell"]["arms"])
    if not sets:
        return None
    lifts = {arm: np.array([_lift(touch for touch in s.touches if touch.by == arm) for s in sets]) for arm in arms}
    series = [Series(arm, arm, values) for arm, values in lifts.items()]
    series.append(Series("both", "sum", np.sum(list(lifts.values()), axis=0)))
    least = minimum_total_force(document)
    if least is not None:
        series.append(Series(MINIMUM, "limit", np.full(len(sets), least), dashed=True))
    return Chart("Hands, vertical force", "N", _times(sets), tuple(series))


def _lift(touches: Iterable[Touch]) -> float:
    return float(sum(touch.force[2] for touch in touches))


def _suction(sets: tuple[ContactSet, ...]) -> Chart | None:
    pads = [next((t for t in s.touches if t.suction_force is not None), None) for s in sets]
    if not any(pads):
        return None
    load = np.array([np.nan if pad is None or pad.suction_force is None else pad.suction_force for pad in pads])
    limit = np.array([np.nan if pad is None or pad.limit is None else pad.limit for pad in pads])
    lines = (Series("load", "suction", load), Series("limit", "limit", limit, dashed=True))
    return Chart("Vacuum cup", "N", _times(sets), lines)


def _times(sets: tuple[ContactSet, ...]) -> Array:
    return np.array([contact_set.time for contact_set in sets])


def _speeds(document: Mapping[str, Any]) -> Chart:
    segments = document["segments"]
    time = np.concatenate([segment["time"] for segment in segments])
    speeds = np.abs(np.concatenate([segment["velocities"] for segment in segments]))
    series = []
    for index, (arm, values) in enumerate(document["cell"]["arms"].items()):
        of_limit = speeds[:, 6 * index : 6 * index + 6] / np.array(values["velocity_max"])
        series.append(Series(arm, arm, 100.0 * of_limit.max(axis=1)))
    series.append(Series("limit", "limit", np.full(len(time), 100.0), dashed=True))
    return Chart("Fastest joint, of its limit", "%", time, tuple(series))
