"""What the simulation of a suction-tool plan says at a moment: robot, tool and objects as physics moved them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from app.viewer.timeline import Moment, Timeline, Touch, between_poses
from app.viewer.tool_story import sucked
from planners.geometry.pose import Array, Transform, from_pose7
from planners.scene.suction_tool import TOOL_NAME


class SimulatedToolTimeline:
    """A simulation, to be asked for any time in [0, `duration`]; times outside are taken to the nearer end.

    Joints and bodies move straight between samples; before the first they are as planned. Fingers open and close as
    planned. Shown are the pull of the cup and the squeeze that each hand needs.
    """

    def __init__(self, document: Mapping[str, Any], planned: Timeline) -> None:
        """Read a document that has a simulation.

        Args:
            document: a plan document.
            planned: its plan.
        """
        simulation = document["simulation"]
        self.duration = float(simulation["time"])
        """When it ended [s]."""
        self._planned, self._segments = planned, document["segments"]
        motion = simulation["motion"]
        self._time = np.array(motion["time"], dtype=float)
        self._positions = np.array(motion["positions"], dtype=float)
        self._tracks = {
            name: (np.array(track["time"], dtype=float), np.array(track["poses"], dtype=float))
            for name, track in motion["bodies"].items()
        }
        self._curves = {curve["name"]: curve for curve in simulation["force_curves"]}
        failed = simulation["failed_at"]
        self._held_until = self.duration if failed is None else float(failed)

    def at(self, time: float) -> Moment:
        """Return where everything is at `time` [s]."""
        time = float(min(max(time, 0.0), self.duration))
        planned = self._planned.at(min(time, self._held_until))
        if not len(self._time) or time < self._time[0]:
            return planned
        low, high, s = _between(self._time, time)
        positions = (1.0 - s) * self._positions[low] + s * self._positions[high]
        poses = {**planned.body_poses, **{name: _pose(*track, time) for name, track in self._tracks.items()}}
        touches = tuple(self._touches(time, planned.segment, poses))
        return Moment(time, planned.segment, positions, planned.widths, poses, touches)

    def _touches(self, time: float, segment: int | None, poses: Mapping[str, Array]) -> Iterator[Touch]:
        if segment is None:
            return
        T_world_tool = from_pose7(poses[TOOL_NAME])
        pull = self._value("suction load", time)
        name = sucked(self._segments, segment)
        if name is not None and pull != 0.0:
            up = T_world_tool[:3, 2]
            yield Touch(TOOL_NAME, name, "suction", None, T_world_tool[:3, 3], -up, pull * up, 0.0, pull, None)
        hold = self._segments[segment]["hold"] or {}
        for grip in (hold.get("grip"), hold.get("second_grip")):
            squeeze = 0.0 if grip is None else self._value(f"{grip['arm']} squeeze", time)
            if grip is not None and squeeze > 0.0:
                yield from _fingers(grip, T_world_tool, squeeze)

    def _value(self, name: str, time: float) -> float:
        curve = self._curves[name]
        return float(np.interp(time, curve["time"], curve["value"]))


def _fingers(grip: Mapping[str, Any], T_world_tool: Transform, squeeze: float) -> Iterator[Touch]:
    """Return both pads, pressing with the squeeze that is needed."""
    T_world_tcp = T_world_tool @ from_pose7(grip["pose"])
    for finger, inward in ((0, 1.0), (1, -1.0)):
        normal = inward * T_world_tcp[:3, 1]
        point = T_world_tcp[:3, 3] - 0.5 * grip["width"] * normal
        yield Touch(grip["arm"], TOOL_NAME, "soft_finger", finger, point, normal, squeeze * normal, 0.0, None, None)


def _between(times: Array, time: float) -> tuple[int, int, float]:
    """Return the samples on both sides of a time, and how far it is from the first to the second."""
    low = max(int(np.searchsorted(times, time, side="right")) - 1, 0)
    high = min(low + 1, len(times) - 1)
    step = times[high] - times[low]
    return low, high, float(np.clip((time - times[low]) / step, 0.0, 1.0)) if step > 0.0 else 0.0


def _pose(times: Array, poses: Sequence[Array] | Array, time: float) -> Array:
    low, high, s = _between(times, time)
    return between_poses(poses[low], poses[high], s)
