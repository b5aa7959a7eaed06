"""The curves of a plate lift: what hands and cup bear, and what the simulation felt."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from app.viewer.curves import (
    MILLIMETRES,
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
from app.viewer.timeline import ContactSet, Timeline, Touch

MINIMUM = "min. m g \u2212 f_cup"


def planned_charts(document: Mapping[str, Any], timeline: Timeline) -> list[Chart]:
    """Return vertical forces of the hands, suction load, reserve and joint speeds; nothing without segments."""
    if not document["segments"]:
        return []
    sets = timeline.contact_sets
    charts = [_hand_forces(document, sets), _suction(sets), reserves(document), speeds(document)]
    return [chart for chart in charts if chart is not None]


def simulated_charts(document: Mapping[str, Any]) -> list[Chart]:
    """Return what the simulated hands, cup and lifter did; nothing for a plan without one."""
    simulation = document["simulation"]
    if not has_curves(simulation):
        return []
    time, curves = simulated_curves(simulation)
    gripping, pushing = (arm_with(document, kind) for kind in ("gripper", "stick"))

    hands = [
        Series(f"{pushing}, pushes", pushing, curves["pushing hand"]),
        Series(f"{gripping}, grips", gripping, curves["gripping hand"]),
        Series("both", "sum", curves["both hands"]),
    ]
    if simulation["minimum_total_force"] is not None:
        hands.append(level(MINIMUM, simulation["minimum_total_force"], time))
    cup = (
        Series("load", "suction", curves["suction load"]),
        level("limit", document["task"]["cup"]["max_force"], time),
    )
    rates = (
        Series("hands, commanded", "sum", MILLIMETRES * curves["commanded velocity"]),
        Series("lifter", "suction", MILLIMETRES * curves["lifter velocity"]),
    )
    return [
        Chart("Hands, vertical force", "N", time, tuple(hands), dips(document)),
        Chart("Vacuum cup", "N", time, cup),
        Chart("Lift, speed upward", "mm/s", time, rates),
        Chart("Plate, tilt", "\u00b0", time, (Series("tilt", "environment", curves["plate tilt"]),)),
    ]


def dips(document: Mapping[str, Any]) -> tuple[Span, ...]:
    """Return when both hands together bore less than the minimum during the simulated lift."""
    simulation = document["simulation"]
    least, lift = simulation["minimum_total_force"], simulation["lift"]
    if least is None or lift is None or not has_curves(simulation):
        return ()
    time, curves = simulated_curves(simulation)
    return spans(time, (curves["both hands"] < least) & (time >= lift["begin"]))


def arm_with(document: Mapping[str, Any], kind: str) -> str:
    """Return the arm whose hand is of a kind."""
    return next(arm for arm, hand in document["cell"]["hands"].items() if hand["kind"] == kind)


def minimum_total_force(document: Mapping[str, Any]) -> float:
    """Return what the hands must bear at least of a plate, m g - f_cup, once nothing else touches it [N]."""
    task = document["task"]
    gravity = float(np.linalg.norm(document["cell"]["gravity"]))
    return task["plate"]["mass"] * gravity - task["cup"]["max_force"]


def _hand_forces(document: Mapping[str, Any], sets: tuple[ContactSet, ...]) -> Chart | None:
    arms = tuple(document["cell"]["arms"])
    if not sets:
        return None
    lifts = {arm: np.array([_lift(touch for touch in s.touches if touch.by == arm) for s in sets]) for arm in arms}
    series = [Series(arm, arm, values) for arm, values in lifts.items()]
    series.append(Series("both", "sum", np.sum(list(lifts.values()), axis=0)))
    time = times(sets)
    series.append(level(MINIMUM, minimum_total_force(document), time))
    return Chart("Hands, vertical force", "N", time, tuple(series))


def _lift(touches: Iterable[Touch]) -> float:
    return float(sum(touch.force[2] for touch in touches))


def _suction(sets: tuple[ContactSet, ...]) -> Chart | None:
    pads = [next((t for t in s.touches if t.suction_force is not None), None) for s in sets]
    if not any(pads):
        return None
    load = np.array([np.nan if pad is None or pad.suction_force is None else pad.suction_force for pad in pads])
    limit = np.array([np.nan if pad is None or pad.limit is None else pad.limit for pad in pads])
    lines = (Series("load", "suction", load), Series("limit", "limit", limit, dashed=True))
    return Chart("Vacuum cup", "N", times(sets), lines)
