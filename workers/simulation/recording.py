"""What is kept of a simulation: curves over time, how bodies moved, and what gave way."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np

from planners.contract.arrays import rounded
from planners.geometry.pose import Array, Transform, rotation_angle, to_pose7s
from planners.plan.simulation import BodyTrack, ForceCurve, LiftEnding, ToolEnding

LIFT_UNITS = {
    "pushing hand": "N",
    "gripping hand": "N",
    "both hands": "N",
    "suction load": "N",
    "commanded velocity": "m/s",
    "lifter velocity": "m/s",
    "plate height": "m",
    "lifter height": "m",
    "plate tilt": "deg",
}
"""Curves of a lift by name. Forces of hands are vertical, upward on the plate; heights count from where it begins."""
TOOL_UNITS = {
    "suction load": "N",
    "suction share": "1",
    "left squeeze": "N",
    "right squeeze": "N",
    "tool off plan": "m",
    "object off plan": "m",
}
"""Curves of a suction-tool plan by name: pull on the cup, share of what the cup bears, the squeeze that each hand
needs, and how far the tool in the hands and the object on the cup are from where the plan has them. Zero while nothing
is held."""
MOTION_EVERY = 2
"""Of the moments that are recorded, how many apart the motion is kept."""
_DIGITS = {"N": 3, "1": 4, "m/s": 5, "deg": 3}
_POSE_DIGITS = 6
_STILL = (2e-5, 1e-4)
"""A body that has moved by less [m, rad] since its last kept pose stands still."""
Ending = TypeVar("Ending", LiftEnding, ToolEnding)


@dataclass(frozen=True)
class Failure(Generic[Ending]):
    """What gave way."""

    outcome: Ending
    time: float
    """[s]"""
    cause: str
    """As a sentence for a person."""


class Recorder:
    """Collects one row of curves at a time."""

    def __init__(self, units: Mapping[str, str], length_digits: int) -> None:
        """Prepare curves with their units by name; lengths are written with so many decimals."""
        self.time: list[float] = []
        self._units, self._digits = units, {**_DIGITS, "m": length_digits}
        self._names = [name.replace(" ", "_") for name in units]
        self._rows: list[tuple[float, ...]] = []

    def add(self, time: float, **values: float) -> None:
        """Keep the values of all curves, named as they are with underscores, at a time [s]."""
        self.time.append(time)
        self._rows.append(tuple([values[name] for name in self._names]))

    def column(self, name: str, since: float = -np.inf) -> Array:
        """Return one curve's values from a time on."""
        index = list(self._units).index(name)
        return np.array([row[index] for time, row in zip(self.time, self._rows, strict=True) if time >= since])

    def curves(self) -> list[ForceCurve]:
        """Return the curves of a plan."""
        time = np.array([round(value, 4) for value in self.time])
        return [
            ForceCurve(
                name=name,
                unit=unit,
                time=time,
                value=np.array([round(row[i], self._digits[unit]) + 0.0 for row in self._rows]),
            )
            for i, (name, unit) in enumerate(self._units.items())
        ]


class Track:
    """Poses of one body: all while it moves, the first and the last while it stands."""

    def __init__(self) -> None:
        self._kept: list[tuple[float, Transform]] = []
        self._last: tuple[float, Transform] | None = None

    def add(self, time: float, T_world_body: Transform) -> None:
        """Take in a pose at a time [s]."""
        now = (time, T_world_body)
        if self._kept and _same(self._kept[-1][1], T_world_body):
            self._last = now
            return
        if self._last is not None:
            self._kept.append(self._last)
        self._kept.append(now)
        self._last = None

    def stated(self) -> BodyTrack:
        """Return the entry of a plan."""
        rows = self._kept if self._last is None else [*self._kept, self._last]
        return BodyTrack(
            time=np.array([round(time, 4) for time, _ in rows]),
            poses=rounded(to_pose7s(np.array([T for _, T in rows])), _POSE_DIGITS),
        )


def _same(T_a: Transform, T_b: Transform) -> bool:
    distance, angle = _STILL
    near = float(np.linalg.norm(T_a[:3, 3] - T_b[:3, 3])) < distance
    return near and rotation_angle(T_a[:3, :3], T_b[:3, :3]) < angle
