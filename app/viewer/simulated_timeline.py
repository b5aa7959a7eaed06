"""What a plan document's simulation says at a moment: the robot and the plate as physics moved them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from app.viewer.timeline import Moment, Timeline, Touch, between_poses
from planners.geometry.pose import Array, Transform, from_pose7, inverse, to_pose7

HAND_CURVES = {"grip": "gripping hand", "push": "pushing hand"}
"""Names of the curves of vertical forces, by what the hand does to the plate."""
UP = np.array([0.0, 0.0, 1.0])


class SimulatedTimeline:
    """A simulation, to be asked for any time in [0, `duration`]; times outside are taken to the nearer end.

    Joints and plate move straight between samples; before the first one they are as planned. Cup and cable follow the
    plate, fingers the plan. A simulation tells the vertical force of each hand and the load of the cup: that is what
    its contacts show, where the hands hold the plate.
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
        self._planned = planned
        self._holds = [segment["hold"] for segment in document["segments"]]
        motion = simulation["motion"]
        self._time = np.array(motion["time"], dtype=float)
        self._positions = np.array(motion["positions"], dtype=float)
        self._plate = np.array(motion["plate"], dtype=float)
        self._lifter = _Lifter(document)
        self._curves = {curve["name"]: curve for curve in simulation["force_curves"]}

    def at(self, time: float) -> Moment:
        """Return where everything is at `time` [s]."""
        time = float(min(max(time, 0.0), self.duration))
        planned = self._planned.at(time)
        if not len(self._time) or time < self._time[0]:
            positions, plate = planned.positions, planned.body_poses["plate"]
        else:
            low = int(np.searchsorted(self._time, time, side="right")) - 1
            high = min(low + 1, len(self._time) - 1)
            step = self._time[high] - self._time[low]
            s = float((time - self._time[low]) / step) if step > 0.0 else 0.0
            positions = (1.0 - s) * self._positions[low] + s * self._positions[high]
            plate = between_poses(self._plate[low], self._plate[high], s)
        T_world_plate = from_pose7(plate)
        return Moment(
            time,
            planned.segment,
            positions,
            planned.widths,
            {**planned.body_poses, "plate": plate, **self._lifter.poses(T_world_plate)},
            tuple(self._touches(time, planned.segment, T_world_plate)),
        )

    def _touches(self, time: float, segment: int | None, T_world_plate: Transform) -> Iterator[Touch]:
        hold = None if segment is None else self._holds[segment]
        for deed, place in (("grip", "pose"), ("push", "point")):
            held = None if hold is None else hold[deed]
            if held is not None:
                point = _apply(T_world_plate, np.array(held[place][:3]))
                force = self._value(HAND_CURVES[deed], time) * UP
                yield Touch(held["arm"], held["body"], "measured", None, point, UP, force, 0.0, None, None)
        yield self._lifter.touch(T_world_plate, self._value("suction load", time))

    def _value(self, name: str, time: float) -> float:
        curve = self._curves[name]
        return float(np.interp(time, curve["time"], curve["value"])) if curve["time"] else 0.0


class _Lifter:
    """Cup and cable: the cup rides on the plate, the cable stands upright on one point of it."""

    def __init__(self, document: Mapping[str, Any]) -> None:
        bodies, cup = document["bodies"], document["bodies"]["cup"]
        T_plate_world = inverse(from_pose7(bodies["plate"]["pose"]))
        self._T_plate_cup = T_plate_world @ from_pose7(cup["pose"])
        self._pad = _apply(self._T_plate_cup, np.array([0.0, 0.0, -0.5 * cup["shape"]["height"]]))
        self._half_cable = np.array([0.0, 0.0, 0.5 * bodies["cable"]["shape"]["height"]])
        self._cable_end = _apply(T_plate_world, np.array(bodies["cable"]["pose"][:3]) - self._half_cable)
        self._is_cable = document["task"]["lifter_model"] == "cable"
        self._cup = document["task"]["cup"]

    def poses(self, T_world_plate: Transform) -> dict[str, Array]:
        cable = [*_apply(T_world_plate, self._cable_end) + self._half_cable, 1.0, 0.0, 0.0, 0.0]
        return {"cup": np.array(to_pose7(T_world_plate @ self._T_plate_cup)), "cable": np.array(cable)}

    def touch(self, T_world_plate: Transform, load: float) -> Touch:
        """Return the cup's pull: along the cable if the lifter is one, else along the pad's normal."""
        outward = T_world_plate[:3, 2]
        pull = load * (UP if self._is_cable else outward)
        point, limit = _apply(T_world_plate, self._pad), self._cup["max_force"]
        return Touch("cup", "plate", "suction", None, point, -outward, pull, self._cup["mu"], load, limit)


def _apply(T_a_b: Transform, point: Array) -> Array:
    return T_a_b[:3, :3] @ point + T_a_b[:3, 3]
