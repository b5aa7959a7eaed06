"""What a suction-tool plan says should happen at any time: joints, grips, vacuum, and where bodies are."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from planners.geometry.pose import Array, Transform, from_pose7
from planners.scene.suction_tool import TOOL_NAME
from workers.simulation.sampled_plan import Place, SampledPlan, between


@dataclass(frozen=True, eq=False)
class PlannedGrip:
    """A hand's grip of the tool."""

    arm: str
    T_tool_tcp: Transform
    width: float
    """[m]"""
    squeeze: float
    """As commanded [N]."""


@dataclass(frozen=True, eq=False)
class PlannedSuction:
    """An object on the cup."""

    name: str
    T_tool_object: Transform


@dataclass(frozen=True, eq=False)
class ToolStage:
    """One segment of the plan, as far as fingers and vacuum are concerned."""

    kind: str
    begin: float
    end: float
    """[s]"""
    grips: tuple[PlannedGrip, ...]
    """In a grip or release the one that is taken or given up comes first."""
    suction: PlannedSuction | None
    """In attach and detach too, where the vacuum comes or goes."""
    moving: Mapping[str, Array]
    """(k, 4, 4) of each body that moves in it, one a sample."""
    resting: Mapping[str, Transform]
    """Where the others are."""

    def part(self, time: float) -> float:
        """Return which part of it is over at a time [s]."""
        return (time - self.begin) / max(self.end - self.begin, 1e-9)


@dataclass(frozen=True, eq=False)
class ToolReference(SampledPlan):
    """The whole plan on one time axis."""

    stages: tuple[ToolStage, ...]

    @classmethod
    def of(cls, document: Mapping[str, Any]) -> Self:
        """Read a solved plan document."""
        segments = document["segments"]
        samples = SampledPlan.joined(segments)
        return cls(
            samples.time, samples.positions, samples.velocities, samples.segment_of, tuple(_stages(document, segments))
        )

    def stage(self, place: Place) -> ToolStage:
        """Return the segment that a place is in."""
        return self.stages[self.segment_of[place[0]]]

    def joints(self, place: Place) -> tuple[Array, Array]:
        """Return positions and velocities (12,) [rad, rad/s]."""
        return between(self.positions, place), between(self.velocities, place)

    def position(self, name: str, place: Place) -> Array:
        """Return where the origin (3,) of a body should be [m]."""
        stage, first = self.stage(place), int(np.searchsorted(self.segment_of, self.segment_of[place[0]]))
        if name not in stage.moving:
            return stage.resting[name][:3, 3]
        return between(stage.moving[name][:, :3, 3], (place[0] - first, place[1] - first, place[2]))

    def touching(self, index: int) -> frozenset[str]:
        """Return the objects that the cup may touch in a segment: those sucked in it, before it or after it."""
        near = self.stages[max(index - 1, 0) : index + 2]
        return frozenset(stage.suction.name for stage in near if stage.suction is not None)


def _stages(document: Mapping[str, Any], segments: Sequence[Mapping[str, Any]]) -> list[ToolStage]:
    places = {name: from_pose7(body["pose"]) for name, body in document["bodies"].items() if not body["static"]}
    stages: list[ToolStage] = []
    for index, segment in enumerate(segments):
        moving = {name: np.array([*map(from_pose7, rows)]) for name, rows in segment["body_poses"].items()}
        time = segment["time"]
        suction = _suction(segments, index)
        stages.append(ToolStage(segment["kind"], time[0], time[-1], _grips(segment), suction, moving, places))
        if moving:
            places = places | {name: poses[-1] for name, poses in moving.items()}
    return stages


def _grips(segment: Mapping[str, Any]) -> tuple[PlannedGrip, ...]:
    hold = segment["hold"]
    if hold is None:
        return ()
    given = (hold["grip"], hold.get("second_grip"))
    return tuple(
        PlannedGrip(one["arm"], from_pose7(one["pose"]), one["width"], one["squeeze"])
        for one in given
        if one is not None
    )


def _suction(segments: Sequence[Mapping[str, Any]], index: int) -> PlannedSuction | None:
    """Return what is on the cup; attach and detach, which attach nothing, have their neighbour's."""
    beside = {"attach": index + 1, "detach": index - 1}.get(segments[index]["kind"], index)
    if not 0 <= beside < len(segments):
        return None
    for name, rides in segments[beside]["attached"].items():
        if any(ride["to"] == TOOL_NAME for ride in rides):
            return PlannedSuction(name, from_pose7(next(r["pose"] for r in rides if r["to"] == TOOL_NAME)))
    return None
