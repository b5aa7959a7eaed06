"""SceneDocument: what was perceived, as JSON. Poses are in the world; lengths in metres, angles in radians."""

from __future__ import annotations

from typing import Literal, Self

from pydantic import model_validator

from planners.contract.shapes import Box, Cylinder
from planners.contract.strict_model import StrictModel

Vector2 = tuple[float, float]
Vector3 = tuple[float, float, float]
Pose7 = tuple[float, float, float, float, float, float, float]

TABLE = "table"
"""What stands on no other object stands on this."""


class TablePart(StrictModel):
    """The table's top as it was seen."""

    point: Vector3
    """On it, in the middle of what was seen."""
    normal: Vector3
    height: float
    """z at the place (x, y) of the cell's table [m]."""
    deviation: float
    """Standard deviation of single points from it [m]."""
    points: int
    """How many lie on it."""


class PoseUncertainty(StrictModel):
    """Uncertainties of the tool's pose: 19 of 20 errors are within twice as much."""

    position: float
    """[m]"""
    rotation: float
    """[rad]"""


class SeenToolPart(StrictModel):
    """The tool as its markers show it."""

    name: str
    pose: Pose7
    """T_world_tool."""
    uncertainty: PoseUncertainty
    markers_at: Vector3
    """The middle of its board of markers [m]: what was seen best."""
    markers: tuple[int, ...]
    """Ids of those that were seen."""
    error: float
    """Root of the mean square of their corners' distances from where they should be [px]."""


class SizeUncertainty(StrictModel):
    """Uncertainties of what is told of an object: 19 of 20 errors are within twice as much."""

    position: Vector3
    """Along the object's own axes [m]."""
    yaw: float
    """About its z axis [rad]; 0 for a cylinder."""
    size: Vector3
    """Of a box: its sides. Of a cylinder: its diameter, twice, and its height [m]."""


class ObjectPart(StrictModel):
    """A box or cylinder that stands upright."""

    name: str
    shape: Box | Cylinder
    pose: Pose7
    """Of its centre; z up, x along the longer side."""
    uncertainty: SizeUncertainty
    supported_by: str
    """What it stands on: "table" or another object's name."""
    top_points: int
    """How many measured points its top was found from."""
    support_points: tuple[Vector3, ...]
    """Some of these points."""


class UnrecognisedPart(StrictModel):
    """Something that is neither a box nor a cylinder that can be told."""

    reason: str
    outline: tuple[Vector2, ...]
    """Its convex hull seen from above, counter-clockwise."""
    top: float
    """z of its highest point."""


class SceneDocument(StrictModel):
    """What was perceived."""

    schema_version: Literal["1.0"] = "1.0"
    cell: str
    """As tasks name it for good: a shipped cell's name, or the id of the version that the scene was perceived in."""
    external_id: str | None
    tool: SeenToolPart | None
    """None: not looked for, or not found; `notes` tells."""
    table: TablePart | None
    """None: there was neither depth nor cloud."""
    objects: tuple[ObjectPart, ...]
    """From left to right."""
    unrecognised: tuple[UnrecognisedPart, ...]
    notes: tuple[str, ...]
    """Sentences on what was not found, and why."""

    @model_validator(mode="after")
    def _all_stand_on_something(self) -> Self:
        lost = {part.name for part in self.objects} - {part.name for part in self.from_the_table_up()}
        if lost:
            raise ValueError(f"neither on the table nor on an object that is: {', '.join(sorted(lost))}")
        return self

    def from_the_table_up(self) -> tuple[ObjectPart, ...]:
        """Return the objects, each behind what it stands on; without any that stand on nothing, or on each other."""
        found: list[ObjectPart] = []
        carriers = {TABLE}
        while standing := [part for part in self.objects if part.supported_by in carriers]:
            found += standing
            carriers = {part.name for part in standing}
            if len(found) > len(self.objects):
                # Two have one name, and stand on it.
                break
        return tuple(found[: len(self.objects)])
