"""Curves: lines over a common time, and those that plans of both kinds have."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from app.viewer.timeline import ContactSet
from planners.geometry.pose import Array

MILLIMETRES = 1e3
PERCENT = 100.0
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


def times(sets: Sequence[ContactSet]) -> Array:
    """Return when contact sets are."""
    return np.array([contact_set.time for contact_set in sets])


def speeds(document: Mapping[str, Any]) -> Chart:
    """Return how fast the fastest joint of each arm turns, of its limit."""
    segments = document["segments"]
    time = np.concatenate([segment["time"] for segment in segments])
    speeds = np.abs(np.concatenate([segment["velocities"] for segment in segments]))
    series = []
    for index, (arm, values) in enumerate(document["cell"]["arms"].items()):
        of_limit = speeds[:, 6 * index : 6 * index + 6] / np.array(values["velocity_max"])
        series.append(Series(arm, arm, PERCENT * of_limit.max(axis=1)))
    series.append(Series("limit", "limit", np.full(len(time), PERCENT), dashed=True))
    return Chart("Fastest joint, of its limit", "%", time, tuple(series))


def reserves(document: Mapping[str, Any]) -> Chart | None:
    """Return which share of the force limits is kept back; None where no segment tells, as in documents of 0.1.0."""
    told = [segment for segment in document["segments"] if segment.get("reserve") is not None]
    if not told:
        return None
    time = np.concatenate([segment["time"] for segment in told])
    # Null, where nothing is held, becomes nan: a gap.
    kept = PERCENT * np.concatenate([np.array(segment["reserve"], dtype=float) for segment in told])
    series = [Series("kept back", "reserve", kept)]
    requested = document["task"].get("options", {}).get("reserve")
    if requested is not None:
        series.append(level("requested", PERCENT * requested, time))
    return Chart("Force reserve", "%", time, tuple(series))


def level(name: str, value: float, time: Array) -> Series:
    """Return a limit that stays."""
    return Series(name, "limit", np.full(len(time), value), dashed=True)


def has_curves(simulation: Mapping[str, Any] | None) -> bool:
    """Tell whether there is a simulation, and it came as far as its first sample."""
    return simulation is not None and any(curve["time"] for curve in simulation["force_curves"])


def simulated_curves(simulation: Mapping[str, Any]) -> tuple[Array, dict[str, Array]]:
    """Return the common time of a simulation's curves and their values by name; of a simulation that has curves."""
    curves = {curve["name"]: np.array(curve["value"], dtype=float) for curve in simulation["force_curves"]}
    return np.array(simulation["force_curves"][0]["time"], dtype=float), curves


def spans(time: Array, which: NDArray[np.bool_]) -> tuple[Span, ...]:
    """Return the stretches in which something holds; one ends with the first sample at which it no longer does."""
    borders = np.flatnonzero(np.diff(np.concatenate([[False], which, [False]]).astype(int)))
    at = time[np.minimum(borders, len(time) - 1)]
    return tuple((float(begin), float(end)) for begin, end in at.reshape(-1, 2))
