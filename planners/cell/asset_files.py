"""What the files of the assets folder say, validated: robots, hands, mounts, cells and tools."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Annotated, Any, Literal, Self, TypeVar

import numpy as np
from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Discriminator,
    Field,
    JsonValue,
    Tag,
    model_validator,
)

from planners.contract.quantities import NAME_PATTERN, Mass, Point3, Pose
from planners.contract.scan_spec import MarkersSpec
from planners.contract.shapes import Mesh
from planners.contract.task_spec import CustomTool, ToolCup, ToolPart
from planners.geometry.pose import Transform, rotation_x, rotation_y, rotation_z, transform

AssetName = Annotated[str, Field(pattern=NAME_PATTERN)]


def _other_than_pad(name: str) -> str:
    if name in ("pad", "base"):
        raise ValueError("pad and base are parts already: another name")
    return name


FINGER_PATTERN = r"^[a-z][a-z0-9_]{0,31}$"
"""Of what slides with a pad."""
FingerPartName = Annotated[str, Field(pattern=FINGER_PATTERN), AfterValidator(_other_than_pad)]
Number = Annotated[float, Field(ge=-1e4, le=1e4)]
"""A larger one is no length, angle, mass or force of a cell, and no sum of such is right any more."""
PositiveNumber = Annotated[float, Field(gt=0.0, le=1e4)]
NotNegative = Annotated[float, Field(ge=0.0, le=1e4)]
Triple = tuple[Number, Number, Number]
Lengths = tuple[PositiveNumber, PositiveNumber, PositiveNumber]
Stroke = Annotated[float, Field(gt=0.0, le=1.0)]
"""Of a gripper [m]: where its pads are is kept for every millimetre."""
PositionLimit = Annotated[float, Field(ge=-540.0, le=540.0)]
"""[deg]: a whole turn away from any position in (-180, 180], and no further; who has more states less."""
AxisAngle = Annotated[float, Field(ge=-180.0, le=180.0)]
"""From one joint's axis to the next [deg]."""
LinkName = Literal["base", "shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3"]
ArmSide = Literal["left", "right"]
RELATIVE_PATH = r"^[A-Za-z0-9_-][A-Za-z0-9_.-]*(?:/[A-Za-z0-9_-][A-Za-z0-9_.-]*)*$"
"""Of a file: forward slashes, and no name that begins with a dot."""

LINK_NAMES: tuple[LinkName, ...] = ("base", "shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3")
"""In the order of the frames they move with."""
ARM_NAMES: tuple[ArmSide, ...] = ("left", "right")
"""In the order of their joints."""
MOST_BODIES = 200
"""Of a platform, and as many columns: each is checked against all that moves, and pairs take time and memory."""


MOST_TOOLS = 50
"""That a cell brings: plan documents carry them."""
MARGIN_RANGE = (0.001, 0.050)
"""Of what a cell may have bodies kept apart by [m]: less is lost between the samples of motion, and with more no hand
gets anywhere."""
JOINTS = 6
"""Of an arm."""
ONLY_SIX_JOINTS = (
    "An arm has six joints here: with a seventh it reaches a pose in infinitely many ways, and plans are made of the "
    "eight of an arm of six"
)


class _Part(BaseModel):
    """A mapping in a file. A number is a number, a field is known, and nothing changes afterwards."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False)


class Asset(_Part):
    """A whole file, found by its name."""

    name: AssetName


class PlacementFile(_Part):
    """Where something sits: `position` [m], turned about the fixed axes x, then y, then z [deg]."""

    position: Triple
    rpy_deg: Triple

    def transform(self) -> Transform:
        """Return `T_parent_child`."""
        roll, pitch, yaw = np.radians(self.rpy_deg)
        return transform(rotation_z(yaw) @ rotation_y(pitch) @ rotation_x(roll), self.position)


class MeshFile(_Part):
    """A mesh: STL, OBJ, PLY or GLB. Collisions are checked with its convex hull."""

    package: Literal["airo_models"] | None = None
    """An installed package that ships it; None: it is among the files of the cell."""
    path: Annotated[str, Field(pattern=RELATIVE_PATH, max_length=200)]
    """Inside the package, or inside the folder that `robots`, `hands` and so on are in."""
    scale: PositiveNumber = 1.0
    """Metres a unit of the file."""


class JointFile(_Part):
    """A row of the Denavit-Hartenberg table, with the joint's limits."""

    name: AssetName
    a: Number
    alpha_deg: AxisAngle
    d: Number
    theta0_deg: Number
    position_deg: tuple[PositionLimit, PositionLimit]
    velocity_deg: PositiveNumber
    """[deg/s]"""
    acceleration: PositiveNumber
    """[rad/s^2]"""
    torque: PositiveNumber
    """[Nm]"""

    @model_validator(mode="after")
    def _range_is_not_empty(self) -> Self:
        if self.position_deg[0] >= self.position_deg[1]:
            raise ValueError("position_deg must list the lower limit first")
        return self


class MeshLinkFile(PlacementFile):
    """A link's mesh, placed in the frame that the link moves with."""

    name: LinkName
    mesh: MeshFile


class CylinderFile(_Part):
    """A cylinder between the centres of its ends, in the frame that its link moves with [m]."""

    start: Triple
    end: Triple
    radius: PositiveNumber

    @model_validator(mode="after")
    def _has_a_length(self) -> Self:
        if self.start == self.end:
            raise ValueError("start and end must be two points")
        return self


class CylinderLinkFile(_Part):
    """A link of which no mesh is known: cylinders within which it is, about the axes of its joints and tubes."""

    name: LinkName
    cylinders: Annotated[tuple[CylinderFile, ...], Field(min_length=1)]


class PiecesLinkFile(_Part):
    """A link as convex pieces: each the corners of one, in the frame that the link moves with [m]."""

    name: LinkName
    pieces: Annotated[
        tuple[Annotated[tuple[Triple, ...], Field(min_length=4, max_length=5000)], ...], Field(min_length=1)
    ]


def _kind_of_link(link: Any) -> str:
    members = link if isinstance(link, Mapping) else ()
    if isinstance(link, CylinderLinkFile) or "cylinders" in members:
        return "[cylinders]"
    return "[pieces]" if isinstance(link, PiecesLinkFile) or "pieces" in members else "[mesh]"


LinkFile = Annotated[
    Annotated[MeshLinkFile, Tag("[mesh]")]
    | Annotated[CylinderLinkFile, Tag("[cylinders]")]
    | Annotated[PiecesLinkFile, Tag("[pieces]")],
    Discriminator(_kind_of_link),
]


class MassFile(_Part):
    """What a link that moves weighs, and where its centre of mass is."""

    name: LinkName
    mass: PositiveNumber
    """[kg]"""
    com: Triple
    """In the frame after the link's joint [m]."""


_OfLink = TypeVar("_OfLink", MeshLinkFile | CylinderLinkFile | PiecesLinkFile, MassFile)


def _six_joints(joints: tuple[JointFile, ...]) -> tuple[JointFile, ...]:
    if len(joints) != JOINTS:
        raise ValueError(f"{len(joints)} are listed. {ONLY_SIX_JOINTS if len(joints) > JOINTS else 'An arm has six'}")
    return joints


def _one_a_joint(values: tuple[float, ...]) -> tuple[float, ...]:
    if len(values) != JOINTS:
        raise ValueError(f"{len(values)} are listed; {JOINTS} are needed, one a joint, base to flange")
    return values


def _of_links(names: Sequence[LinkName]) -> Callable[[tuple[_OfLink, ...]], tuple[_OfLink, ...]]:
    """Return what refuses a list that is not of these links, in this order."""

    def check(listed: tuple[_OfLink, ...]) -> tuple[_OfLink, ...]:
        given = [each.name for each in listed]
        missing = [name for name in names if name not in given]
        if missing:
            raise ValueError(f"{', '.join(missing)} {'is' if len(missing) == 1 else 'are'} missing")
        if given != list(names):
            raise ValueError(f"must be named {', '.join(names)}, in this order, each once")
        return listed

    return check


def _so_many(count: int) -> dict[str, JsonValue]:
    """Return what a schema says of a list that a validator counts: pydantic counts only what is valid in itself."""
    return {"minItems": count, "maxItems": count}


OfEachJoint = Annotated[
    tuple[PositiveNumber, ...], AfterValidator(_one_a_joint), Field(json_schema_extra=_so_many(JOINTS))
]


class RobotFile(Asset):
    """robots/*.yaml: one arm, whatever it is mounted on."""

    base: PlacementFile | None = None
    """Where the frame before the first joint is, on the frame with which the arm is mounted; None: they are one."""
    joints: Annotated[tuple[JointFile, ...], AfterValidator(_six_joints), Field(json_schema_extra=_so_many(JOINTS))]
    links: (
        Annotated[
            tuple[LinkFile, ...], AfterValidator(_of_links(LINK_NAMES)), Field(json_schema_extra=_so_many(JOINTS + 1))
        ]
        | None
    ) = None
    links_of: AssetName | None = None
    """Another robot whose links stand in."""
    masses: Annotated[
        tuple[MassFile, ...], AfterValidator(_of_links(LINK_NAMES[1:])), Field(json_schema_extra=_so_many(JOINTS))
    ]
    """Of all links but the base."""
    payload: PositiveNumber
    """[kg]"""
    reach: PositiveNumber
    """[m]"""

    @model_validator(mode="after")
    def _links_are_said_once(self) -> Self:
        if (self.links is None) == (self.links_of is None):
            raise ValueError("exactly one of links and links_of is required")
        return self


class UrdfRobotFile(Asset):
    """robots/*.yaml of a cell of one's own: the arm between two links of a URDF, and what a URDF does not say."""

    urdf: Annotated[str, Field(pattern=RELATIVE_PATH, max_length=200)]
    """Its path among the files of the cell; what it names by `package://` is looked for there as well."""
    root: Annotated[str, Field(max_length=200)]
    """The link with which the arm is mounted."""
    tip: Annotated[str, Field(max_length=200)]
    """The link that hands are bolted to, its z axis out of the flange."""
    payload: PositiveNumber
    """[kg]"""
    acceleration: OfEachJoint
    """Base to flange [rad/s^2]."""
    torque: OfEachJoint | None = None
    """[Nm]; None: each joint's `effort`."""
    mass: OfEachJoint | None = None
    """Of the links that move [kg]; None: of their `inertial`."""


class SensorFile(Asset):
    """sensors/*.yaml: a force-torque sensor with its coupling, a cylinder from the flange on."""

    radius: PositiveNumber
    """[m]"""
    length: PositiveNumber
    """From the flange to the hand [m]."""
    mass: PositiveNumber
    """[kg]"""
    force_max: PositiveNumber
    """Range per axis [N]."""
    torque_max: PositiveNumber
    """Range per axis [Nm]."""
    rate: PositiveNumber
    """[Hz]"""
    force_noise: NotNegative
    """Standard deviation per axis [N]."""
    torque_noise: NotNegative
    """Standard deviation per axis [Nm]."""


class LinkageFile(_Part):
    """Joint origins [y, z] of a four-bar finger on the +y side, fully open [m]."""

    outer_knuckle: tuple[Number, Number]
    outer_finger: tuple[Number, Number]
    inner_finger: tuple[Number, Number]
    pad: tuple[Number, Number]
    inner_knuckle: tuple[Number, Number]


class GripperMeshes(_Part):
    """The convex pieces of a gripper: its base, and the parts that both fingers have."""

    base: MeshFile
    outer_knuckle: MeshFile
    outer_finger: MeshFile
    inner_finger: MeshFile
    inner_knuckle: MeshFile


class _HandFile(Asset):
    sensor: AssetName | None = None
    """Between flange and hand. None: nothing is, as where the arm has one of its own."""
    mass: PositiveNumber
    """[kg], without the sensor."""
    com: NotNegative
    """Centre of mass of hand and sensor on the flange's z axis [m]."""


class GripperFile(_HandFile):
    """hands/*.yaml of kind gripper: two parallel fingers that open along the flange's y axis."""

    kind: Literal["gripper"]
    force_range: tuple[PositiveNumber, PositiveNumber]
    """Least and greatest grip force [N]."""
    squeeze: PositiveNumber
    """Grip force that is commanded where no task says otherwise [N]."""
    width_max: Stroke
    """How far the pads' inner faces are apart at most [m]."""
    linkage: LinkageFile
    pad_size: Lengths
    """Width, thickness in the opening direction, length [m]."""
    meshes: GripperMeshes


class BoxFile(_Part):
    """A box along the axes of what it is a part of."""

    center: Triple
    size: Lengths
    """Full lengths [m]."""


class JawsFile(_HandFile):
    """hands/*.yaml of kind jaws: a gripper whose two fingers slide along the flange's y axis, all of it boxes.

    Positions are from where the hand is bolted to the sensor, z away from the flange. The finger at +y is described,
    closed: the inner face of its pad is at y = 0, and nothing of it is beyond that.
    """

    kind: Literal["jaws"]
    force_range: tuple[PositiveNumber, PositiveNumber]
    """Least and greatest grip force [N]."""
    squeeze: PositiveNumber
    """Grip force that is commanded where no task says otherwise [N]."""
    width_max: Stroke
    """How far the pads' inner faces are apart at most [m]."""
    pad_size: Lengths
    """Width, thickness in the opening direction, length [m]."""
    pad_height: PositiveNumber
    """Of the pads' centres [m]."""
    base: BoxFile
    """What does not move."""
    finger: Annotated[dict[FingerPartName, BoxFile], Field(min_length=1, max_length=8)]
    """By names of one's own: what slides with the pad."""

    @model_validator(mode="after")
    def _fingers_do_not_meet(self) -> Self:
        for name, part in self.finger.items():
            beyond = 0.5 * part.size[1] - part.center[1]
            if beyond > 0.0:
                raise ValueError(f"finger.{name} is {1e3 * beyond:.1f} mm beyond the middle, where the pad's face is")
        return self


class StickFile(_HandFile):
    """hands/*.yaml of kind stick: a rod along the flange's z axis with a round tip."""

    kind: Literal["stick"]
    tip_distance: PositiveNumber
    """From the flange to the tip's pole [m]."""
    tip_radius: PositiveNumber
    stick_radius: PositiveNumber
    tip_length: NotNegative
    """How far the part that may touch reaches back from the centre of the tip's hemisphere [m]."""


HandFile = GripperFile | JawsFile | StickFile


class ToolMeshFile(_Part):
    """A part of a tool that is a mesh among the files of the cell: one closed solid, in the tool frame by `pose`."""

    mesh: MeshFile
    pose: Pose
    """Mesh frame in the tool frame."""


def _of_no_upload(part: ToolPart) -> ToolPart:
    if isinstance(part.shape, Mesh) and part.shape.upload is not None:
        raise ValueError("a cell has its meshes among its own files: mesh: {path: ...} in place of shape")
    return part


def _kind_of_tool_part(part: Any) -> str:
    is_mesh = isinstance(part, ToolMeshFile) or (isinstance(part, Mapping) and "mesh" in part)
    return "[mesh]" if is_mesh else "[shape]"


ToolPartFile = Annotated[
    Annotated[ToolPart, AfterValidator(_of_no_upload), Tag("[shape]")] | Annotated[ToolMeshFile, Tag("[mesh]")],
    Discriminator(_kind_of_tool_part),
]


class DescribedToolFile(_Part):
    """A suction tool as a task would describe its own, but for meshes; the frame is that of `CustomTool`."""

    shapes: Annotated[tuple[ToolPartFile, ...], Field(min_length=1, max_length=64)]
    mass: Mass
    com: Point3
    """Centre of mass in the tool frame [m]. The certificate takes it from here, so as not to ask the shapes that the
    planner asked."""
    cup: ToolCup

    def as_task(self) -> CustomTool | None:
        """Return what a task would say of it; None: it has a mesh of the cell's files, which no task can name."""
        parts = tuple(part for part in self.shapes if isinstance(part, ToolPart))
        return CustomTool(shapes=parts, mass=self.mass, com=self.com, cup=self.cup) if parts == self.shapes else None


class ToolFile(Asset):
    """tools/*.yaml: a suction tool."""

    tool: DescribedToolFile
    markers: MarkersSpec | None = None
    """By which cameras find it."""


class ArmMountFile(PlacementFile):
    """Where an arm's base frame is in the world, and where its joints rest."""

    home_deg: tuple[Number, Number, Number, Number, Number, Number]


class MeshBodyFile(PlacementFile):
    """A mesh of one closed solid, hollows and all, placed in the world."""

    mesh: MeshFile


def _kind_of_body(body: Any) -> str:
    return "[mesh]" if isinstance(body, MeshBodyFile) or (isinstance(body, Mapping) and "mesh" in body) else "[box]"


StillBodyFile = Annotated[
    Annotated[BoxFile, Tag("[box]")] | Annotated[MeshBodyFile, Tag("[mesh]")], Discriminator(_kind_of_body)
]


class FrameFile(_Part):
    """Upright profiles of a square section, from the floor up."""

    profile: PositiveNumber
    height: PositiveNumber
    columns: Annotated[tuple[tuple[Number, Number], ...], Field(max_length=MOST_BODIES)]
    """Centres [x, y] on the floor [m]."""


class MountFile(Asset):
    """mounts/*.yaml: everything of a cell that does not depend on which hands the arms carry."""

    arms: dict[ArmSide, ArmMountFile]
    table: BoxFile
    platform: Annotated[dict[AssetName, StillBodyFile], Field(max_length=MOST_BODIES)]
    """What the arms are mounted on, and whatever else never moves: pedestals, fences, the legs of the table."""
    frame: FrameFile

    @model_validator(mode="after")
    def _both_arms_are_mounted(self) -> Self:
        _require_both_arms(self.arms)
        return self


class ArmFile(_Part):
    """Which robot an arm is and what it carries."""

    robot: AssetName
    hand: AssetName


class ToolRestFile(_Part):
    """A square socket on the table in which a suction tool stands upright."""

    position: tuple[Number, Number]
    """Its centre [m]."""
    clearance: PositiveNumber
    """From the centre to the inner faces of the walls [m]."""
    height: PositiveNumber
    """Of the walls [m]."""
    thickness: PositiveNumber
    """Of the walls [m]."""


class LifterFile(_Part):
    """The vacuum lifter of a cell for plate lifts; what is left out is as common bellows and ropes are."""

    cup_height: PositiveNumber = 0.04
    """From the plate to where the cable begins [m]."""
    cable_radius: PositiveNumber = 0.010
    """[m]"""
    cable_length: PositiveNumber = 1.1
    """From the cup up to the trolley, which follows above it [m]."""
    max_force: PositiveNumber | None = None
    """What it lifts at most, whatever a task says of its cup [N]; None: what the task says."""


def _within_margin_range(margin: float) -> float:
    least, most = MARGIN_RANGE
    if not least <= margin <= most:
        raise ValueError(f"{margin:g} m is not within {least:g} to {most:g} m, which is {_mm(least)} to {_mm(most)} mm")
    return margin


def _mm(length: float) -> str:
    return f"{1e3 * length:g}"


class MarginsFile(_Part):
    """The collision margins of a cell: how far planning keeps apart what must not touch."""

    bodies: Annotated[
        Number,
        AfterValidator(_within_margin_range),
        Field(json_schema_extra={"minimum": MARGIN_RANGE[0], "maximum": MARGIN_RANGE[1]}),
    ]
    """Between any two bodies that have nothing to do with one another [m]."""


class CellFile(Asset):
    """cells/*.yaml."""

    mount: AssetName
    arms: dict[ArmSide, ArmFile]
    gravity: Triple
    """[m/s^2]"""
    tool_rest: ToolRestFile | None = None
    lifter: LifterFile | None = None
    margins: MarginsFile | None = None
    """None: what planning keeps where no cell says otherwise."""

    @model_validator(mode="after")
    def _both_arms_are_there(self) -> Self:
        _require_both_arms(self.arms)
        return self


def _require_both_arms(arms: Mapping[ArmSide, object]) -> None:
    missing = [name for name in ARM_NAMES if name not in arms]
    if missing:
        raise ValueError(f"arms.{missing[0]} is required")
