"""What is kept of a simulated suction-tool plan: curves over time, and how everything moved."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from planners.contract.arrays import rounded
from planners.geometry.pose import Array, Transform, rotation_angle, to_pose7s
from planners.plan.simulation import BodyTrack, ForceCurve, SimulatedToolMotion
from workers.simulation.free_body import FreeBody

TOOL_UNITS = {
    "suction load": "N",
    "suction share": "1",
    "left squeeze": "N",
    "right squeeze": "N",
    "tool off plan": "m",
    "object off plan": "m",
}
"""Curves by name: pull on the cup, share of what the cup bears, the squeeze that each hand needs, and how far the tool
in the hands and the object on the cup are from where the plan has them. Zero while nothing is held."""
MOTION_EVERY = 2
"""Of the moments that are recorded, how many apart the motion is kept."""
_DIGITS = {"N": 3, "1": 4, "m": 6}
_POSE_DIGITS = 6
_STILL = (2e-5, 1e-4)
"""A body that has moved by less [m, rad] since its last kept pose stands still."""


class ToolRecorder:
    """Collects one row of curves at a time, joints with it, and poses of what moves."""

    def __init__(self) -> None:
        self.time: list[float] = []
        self._rows: list[tuple[float, ...]] = []
        self._motion: list[tuple[float, Array]] = []
        self._tracks: dict[str, _Track] = {}

    def add(self, time: float, positions: Array, bodies: Iterable[tuple[str, FreeBody]], **values: float) -> None:
        """Keep one moment.

        Args:
            time: [s].
            positions: (12,) [rad].
            bodies: all free ones by name.
            values: of all curves, named as in `TOOL_UNITS` with underscores.
        """
        self.time.append(time)
        self._rows.append(tuple(values[name.replace(" ", "_")] for name in TOOL_UNITS))
        if len(self.time) % MOTION_EVERY != 1:
            return
        self._motion.append((time, positions.copy()))
        for name, body in bodies:
            self._tracks.setdefault(name, _Track()).add(time, body.T_world_body)

    def curves(self) -> list[ForceCurve]:
        """Return the curves of a plan."""
        time = np.array([round(value, 4) for value in self.time])
        columns = zip(*self._rows, strict=True) if self._rows else [()] * len(TOOL_UNITS)
        return [
            ForceCurve(name=name, unit=unit, time=time, value=np.array([round(v, _DIGITS[unit]) + 0.0 for v in values]))
            for (name, unit), values in zip(TOOL_UNITS.items(), columns, strict=True)
        ]

    def motion(self) -> SimulatedToolMotion:
        """Return how robot and bodies moved, for playing it back; each body's poses have times of their own."""
        return SimulatedToolMotion(
            time=np.array([round(time, 4) for time, _ in self._motion]),
            positions=rounded(np.array([positions for _, positions in self._motion]).reshape(-1, 12), 5),
            bodies={name: track.stated() for name, track in self._tracks.items()},
        )

    def largest(self, name: str) -> float:
        """Return the greatest value of a curve, 0 if there is none."""
        index = list(TOOL_UNITS).index(name)
        return max((row[index] for row in self._rows), default=0.0)


class _Track:
    """Poses of one body: all while it moves, the first and the last while it stands."""

    def __init__(self) -> None:
        self._kept: list[tuple[float, Transform]] = []
        self._last: tuple[float, Transform] | None = None

    def add(self, time: float, T_world_body: Transform) -> None:
        now = (time, T_world_body)
        if self._kept and _same(self._kept[-1][1], T_world_body):
            self._last = now
            return
        if self._last is not None:
            self._kept.append(self._last)
        self._kept.append(now)
        self._last = None

    def stated(self) -> BodyTrack:
        rows = self._kept if self._last is None else [*self._kept, self._last]
        return BodyTrack(
            time=np.array([round(time, 4) for time, _ in rows]),
            poses=rounded(to_pose7s(np.array([T for _, T in rows])), _POSE_DIGITS),
        )


def _same(T_a: Transform, T_b: Transform) -> bool:
    distance, angle = _STILL
    near = float(np.linalg.norm(T_a[:3, 3] - T_b[:3, 3])) < distance
    return near and rotation_angle(T_a[:3, :3], T_b[:3, :3]) < angle
