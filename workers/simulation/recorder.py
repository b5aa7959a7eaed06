"""What is kept of a simulation: curves over time."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from planners.geometry.pose import Array
from planners.plan.simulation import ForceCurve

UNITS = {
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
"""Curves by name. Forces of hands are vertical, upward on the plate; heights count from where the lift begins."""
_DIGITS = {"N": 3, "m/s": 5, "m": 5, "deg": 3}


@dataclass
class Recorder:
    """Collects one row at a time."""

    time: list[float] = field(default_factory=list)
    rows: list[tuple[float, ...]] = field(default_factory=list)

    def add(self, time: float, **values: float) -> None:
        """Keep the values of all curves, named as in `UNITS` with underscores, at a time [s]."""
        self.time.append(time)
        self.rows.append(tuple(values[name.replace(" ", "_")] for name in UNITS))

    def column(self, name: str, since: float = -np.inf) -> Array:
        """Return one curve's values from a time on."""
        index = list(UNITS).index(name)
        return np.array([row[index] for time, row in zip(self.time, self.rows, strict=True) if time >= since])

    def curves(self) -> list[ForceCurve]:
        """Return the curves of a plan."""
        time = np.array([round(value, 4) for value in self.time])
        return [
            ForceCurve(
                name=name,
                unit=unit,
                time=time,
                value=np.array([round(row[i], _DIGITS[unit]) + 0.0 for row in self.rows]),
            )
            for i, (name, unit) in enumerate(UNITS.items())
        ]
