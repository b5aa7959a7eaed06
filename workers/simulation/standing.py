"""Watches what nothing holds: it has to stay where it was let go."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np

from planners.geometry.pose import Transform
from planners.scene.suction_tool import TOOL_NAME
from workers.simulation.free_body import FreeBody
from workers.simulation.outcome import Failure, ToolOutcome
from workers.simulation.tool_settings import WatchSettings


class Standing:
    """Remembers where each free body was let go."""

    def __init__(self, bodies: Mapping[str, FreeBody], settings: WatchSettings) -> None:
        """Begin with all bodies standing where they are."""
        self._bodies, self._settings = dict(bodies), settings
        self._places = {name: body.T_world_body for name, body in self._bodies.items()}
        self._centers = {name: body.center for name, body in self._bodies.items()}

    def look(self, held: Iterable[str], time: float) -> Failure[ToolOutcome] | None:
        """Return what has fallen, toppled or been pushed until a time [s]; what is held now may do as it likes."""
        held = frozenset(held)
        failure = None
        for name, body in self._bodies.items():
            if name in held:
                self._places[name], self._centers[name] = body.T_world_body, body.center
            elif failure is None:
                failure = self._fallen(name, body, time)
        return failure

    def _fallen(self, name: str, body: FreeBody, time: float) -> Failure[ToolOutcome] | None:
        s, way = self._settings, body.center - self._centers[name]
        turned = _tilt(self._places[name], body.T_world_body)
        if -way[2] > s.fall:
            if name == TOOL_NAME:
                return Failure(ToolOutcome.TOOL_SLIPPED, time, "the tool fell: no hand held it and it stood on nothing")
            return Failure(ToolOutcome.OBJECT_DROPPED, time, f"{name} fell where the vacuum let it go")
        if turned > s.tilt:
            return Failure(ToolOutcome.TOPPLED, time, f"{name} toppled over")
        shift = float(np.hypot(way[0], way[1]))
        if shift > s.shift:
            return Failure(ToolOutcome.OFF_GOAL, time, f"{name} was pushed {1e3 * shift:.0f} mm from where it stood")
        return None


def _tilt(T_world_a: Transform, T_world_b: Transform) -> float:
    """Return by how much the vertical of one pose is off that of another [rad]."""
    return float(np.arccos(np.clip(T_world_a[2, :3] @ T_world_b[2, :3], -1.0, 1.0)))
