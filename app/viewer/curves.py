"""The curves of a plan: what the hands and the cup bear, how fast the joints turn, and what the simulation felt."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from app.viewer.timeline import ContactSet, Timeline, Touch
from planners.geometry.pose import Array

CYCLE = ("left", "right", "suction", "environment", "goal", "start")
"""Colours of simulated curves whose names say nothing about who is meant."""


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


def planned_charts(document: Mapping[str, Any], timeline: Timeline) -> list[Chart]:
    """Return vertical forces of the hands, suction load and joint speeds; nothing for a plan without segments."""
    if not document["segments"]:
        return []
    charts = [_hand_forces(document, timeline.contact_sets), _suction(timeline.contact_sets), _speeds(document)]
    return [chart for chart in charts if chart is not None]


def simulated_charts(document: Mapping[str, Any]) -> list[Chart]:
    """Return the simulation's curves, one chart a unit; nothing for a plan without a simulation."""
    simulation = document["simulation"]
    if simulation is None:
        return []
    units = dict.fromkeys(curve["unit"] for curve in simulation["force_curves"])
    return [_simulated(simulation, unit) for unit in units]


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
        series.append(Series("min. m g \u2212 f_cup", "limit", np.full(len(sets), least), dashed=True))
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


def _simulated(simulation: Mapping[str, Any], unit: str) -> Chart:
    curves = [curve for curve in simulation["force_curves"] if curve["unit"] == unit]
    time = np.unique(np.concatenate([np.asarray(curve["time"], dtype=float) for curve in curves]))
    series = [
        Series(
            curve["name"].replace("_", " "),
            _colour(curve["name"], index),
            np.interp(time, curve["time"], curve["value"], left=np.nan, right=np.nan),
        )
        for index, curve in enumerate(curves)
    ]
    least = simulation["minimum_total_force"]
    if unit == "N" and least is not None:
        series.append(Series("min. m g \u2212 f_cup", "limit", np.full(len(time), least), dashed=True))
    title = {"N": "Simulated forces", "m/s": "Simulated speed commands"}.get(unit, series[0].name.capitalize())
    return Chart(title, unit, time, tuple(series))


def _colour(name: str, index: int) -> str:
    named = {"left": "left", "right": "right", "suction": "suction", "cup": "suction", "sum": "sum", "total": "sum"}
    words = name.lower().replace("_", " ").split()
    return next((named[word] for word in words if word in named), CYCLE[index % len(CYCLE)])
