"""What the files of robots, hands and sensors say of their shapes: the certificate's own reading of them.

Nothing is checked that the cell's reader refuses (`planners.cell.asset_files`), and what makes no shape is not read.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, RootModel

_Triple = tuple[float, float, float]


class _Record(BaseModel):
    model_config = ConfigDict(frozen=True)


class SensorRecord(_Record):
    """A force-torque sensor with its coupling: a cylinder from the flange on [m]."""

    radius: float
    length: float


class MeshRecord(_Record):
    """A mesh that an installed package ships, or that is among the files of the cell."""

    package: str | None = None
    path: str
    """Inside the package, or inside the folder that `robots`, `hands` and so on are in."""
    scale: float = 1.0
    """Metres a unit of the file."""


class CylinderRecord(_Record):
    """A cylinder between the centres of its ends, in the frame that its link moves with [m]."""

    start: _Triple
    end: _Triple
    radius: float


class LinkRecord(_Record):
    """A link as a mesh, as convex pieces or as cylinders."""

    name: str
    mesh: MeshRecord | None = None
    rpy_deg: _Triple = (0.0, 0.0, 0.0)
    """Of the mesh in the frame that the link moves with, about its fixed axes x, then y, then z [deg]."""
    position: _Triple = (0.0, 0.0, 0.0)
    """Of the mesh in that frame [m]."""
    pieces: tuple[tuple[_Triple, ...], ...] = ()
    """Corners of each piece in that frame [m]."""
    cylinders: tuple[CylinderRecord, ...] = ()


class JointRecord(_Record):
    """A row of the Denavit-Hartenberg table [m] [deg]."""

    a: float
    alpha_deg: float
    d: float
    theta0_deg: float


class RobotRecord(_Record):
    """An arm."""

    joints: tuple[JointRecord, ...]
    links: tuple[LinkRecord, ...] = ()
    links_of: str | None = None
    """Another robot whose links stand in."""


class BoxRecord(_Record):
    """A box along the axes of what it is a part of [m]."""

    center: _Triple
    size: _Triple


class LinkageRecord(_Record):
    """Joint origins [y, z] of a four-bar finger on the +y side, fully open [m]."""

    outer_knuckle: tuple[float, float]
    outer_finger: tuple[float, float]
    inner_finger: tuple[float, float]
    pad: tuple[float, float]
    inner_knuckle: tuple[float, float]


class GripperHulls(_Record):
    """The convex pieces of a gripper: its base, and the parts that both fingers have."""

    base: MeshRecord
    outer_knuckle: MeshRecord
    outer_finger: MeshRecord
    inner_knuckle: MeshRecord
    inner_finger: MeshRecord

    @property
    def finger(self) -> Mapping[str, MeshRecord]:
        """Every part of a finger, by name."""
        return {name: mesh for name, mesh in self if name != "base"}


class GripperRecord(_Record):
    """A gripper whose fingers are four-bar linkages."""

    kind: Literal["gripper"]
    sensor: str | None = None
    pad_size: _Triple
    """Width, thickness in the opening direction, length [m]."""
    linkage: LinkageRecord
    meshes: GripperHulls


class JawsRecord(_Record):
    """A gripper whose fingers slide; from where it is bolted to the sensor, the finger at +y, closed [m]."""

    kind: Literal["jaws"]
    sensor: str | None = None
    pad_size: _Triple
    """Width, thickness in the opening direction, length [m]."""
    pad_height: float
    """Of the pads' centres [m]."""
    width_max: float
    """Stroke [m]."""
    base: BoxRecord
    finger: Mapping[str, BoxRecord]


class StickRecord(_Record):
    """A rod along the flange's z axis with a round tip [m]."""

    kind: Literal["stick"]
    sensor: str | None = None
    tip_distance: float
    """From the flange to the tip's pole."""
    tip_radius: float
    stick_radius: float
    tip_length: float
    """Of what may touch, back from the centre of the tip's hemisphere."""


class HandRecord(RootModel[Annotated[GripperRecord | JawsRecord | StickRecord, Field(discriminator="kind")]]):
    """What an arm holds or pushes with."""
