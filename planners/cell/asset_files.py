"""What the files of the assets folder say, validated: robots, hands, mounts, cells and tools."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Any, Literal, Self, TypeVar

import numpy as np
import yaml
from pydantic import AfterValidator, BaseModel, ConfigDict, Discriminator, Field, Tag, ValidationError, model_validator
from scipy.spatial import ConvexHull, QhullError

from assets import assets_folder
from planners.contract.scan_spec import MarkersSpec
from planners.contract.task_spec import CustomTool
from planners.errors import AssetError
from planners.geometry.mesh_file import obj_vertices
from planners.geometry.pose import Array, Transform, rotation_x, rotation_y, rotation_z, transform

AssetName = Annotated[str, Field(pattern=r"^[A-Za-z0-9_-]{1,64}$")]
PositiveNumber = Annotated[float, Field(gt=0.0)]
NotNegative = Annotated[float, Field(ge=0.0)]
Triple = tuple[float, float, float]
Lengths = tuple[PositiveNumber, PositiveNumber, PositiveNumber]
PositionLimit = Annotated[float, Field(ge=-540.0, le=540.0)]
"""[deg]: a whole turn away from any position in (-180, 180], and no further; who has more states less."""
AxisAngle = Annotated[float, Field(ge=-180.0, le=180.0)]
"""From one joint's axis to the next [deg]."""
LinkName = Literal["base", "shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3"]
ArmSide = Literal["left", "right"]

LINK_NAMES: tuple[LinkName, ...] = ("base", "shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3")
"""In the order of the frames they move with."""
ARM_NAMES: tuple[ArmSide, ...] = ("left", "right")
"""In the order of their joints."""

MESHES = "meshes"
"""The folder of meshes, all OBJ and in metres."""


JOINTS = 6
"""Of an arm."""
ONLY_SIX_JOINTS = (
    "An arm has six joints here: with a seventh it reaches a pose in infinitely many ways, and plans are made of the "
    "eight of an arm of six"
)


class _Part(BaseModel):
    """A mapping in a file. A number is a number, a field is known, and nothing changes afterwards."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False)


class _Asset(_Part):
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
    """A mesh that an installed package ships."""

    package: Annotated[str, Field(pattern=r"^[A-Za-z_][A-Za-z0-9_]*$")]
    path: str
    """Inside the package."""
    scale: PositiveNumber = 1.0
    """Metres a unit of the file."""


class JointFile(_Part):
    """A row of the Denavit-Hartenberg table, with the joint's limits."""

    name: AssetName
    a: float
    alpha_deg: AxisAngle
    d: float
    theta0_deg: float
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
    if isinstance(link, CylinderLinkFile) or "cylinders" in link:
        return "[cylinders]"
    return "[pieces]" if isinstance(link, PiecesLinkFile) or "pieces" in link else "[mesh]"


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


def _no_seventh(joints: tuple[JointFile, ...]) -> tuple[JointFile, ...]:
    if len(joints) > JOINTS:
        raise ValueError(f"{len(joints)} are listed. {ONLY_SIX_JOINTS}")
    return joints


class RobotFile(_Asset):
    """robots/*.yaml: one arm, whatever it is mounted on."""

    base: PlacementFile | None = None
    """Where the frame before the first joint is, on the frame with which the arm is mounted; None: they are one."""
    joints: Annotated[tuple[JointFile, ...], Field(min_length=JOINTS), AfterValidator(_no_seventh)]
    links: Annotated[tuple[LinkFile, ...], Field(min_length=7, max_length=7)] | None = None
    links_of: AssetName | None = None
    """Another robot whose links stand in."""
    masses: Annotated[tuple[MassFile, ...], Field(min_length=6, max_length=6)]
    """Of all links but the base."""
    payload: PositiveNumber
    """[kg]"""
    reach: PositiveNumber
    """[m]"""

    @model_validator(mode="after")
    def _links_are_complete(self) -> Self:
        if (self.links is None) == (self.links_of is None):
            raise ValueError("exactly one of links and links_of is required")
        if self.links is not None and tuple(link.name for link in self.links) != LINK_NAMES:
            raise ValueError(f"links must be named {', '.join(LINK_NAMES)}, in this order")
        if tuple(link.name for link in self.masses) != LINK_NAMES[1:]:
            raise ValueError(f"masses must be named {', '.join(LINK_NAMES[1:])}, in this order")
        return self


class SensorFile(_Asset):
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

    outer_knuckle: tuple[float, float]
    outer_finger: tuple[float, float]
    inner_finger: tuple[float, float]
    pad: tuple[float, float]
    inner_knuckle: tuple[float, float]


class GripperMeshes(_Part):
    """The convex pieces of a gripper: its base, and the parts that both fingers have."""

    base: MeshFile
    outer_knuckle: MeshFile
    outer_finger: MeshFile
    inner_finger: MeshFile
    inner_knuckle: MeshFile


class _HandFile(_Asset):
    sensor: AssetName
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
    width_max: PositiveNumber
    linkage: LinkageFile
    pad_size: Lengths
    """Width, thickness in the opening direction, length [m]."""
    meshes: GripperMeshes


class StickFile(_HandFile):
    """hands/*.yaml of kind stick: a rod along the flange's z axis with a round tip."""

    kind: Literal["stick"]
    tip_distance: PositiveNumber
    """From the flange to the tip's pole [m]."""
    tip_radius: PositiveNumber
    stick_radius: PositiveNumber
    tip_length: NotNegative
    """How far the part that may touch reaches back from the centre of the tip's hemisphere [m]."""


class ToolFile(_Asset):
    """tools/*.yaml: a suction tool, as a task would describe its own, with a stated centre of mass."""

    tool: CustomTool
    markers: MarkersSpec | None = None
    """By which cameras find it."""

    @model_validator(mode="after")
    def _states_its_centre_of_mass(self) -> Self:
        # The certificate takes it from here, so as not to ask the shapes that the planner asked.
        if self.tool.com is None:
            raise ValueError("tool.com is required")
        return self


class ArmMountFile(PlacementFile):
    """Where an arm's base frame is in the world, and where its joints rest."""

    home_deg: tuple[float, float, float, float, float, float]


class BoxFile(_Part):
    """A box along the world's axes."""

    center: Triple
    size: Lengths
    """Full lengths [m]."""


class FrameFile(_Part):
    """Upright profiles of a square section, from the floor up."""

    profile: PositiveNumber
    height: PositiveNumber
    columns: tuple[tuple[float, float], ...]
    """Centres [x, y] on the floor [m]."""


class MountFile(_Asset):
    """mounts/*.yaml: everything of a cell that does not depend on which hands the arms carry."""

    arms: dict[ArmSide, ArmMountFile]
    table: BoxFile
    platform: dict[AssetName, BoxFile]
    """What the arms are mounted on."""
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

    position: tuple[float, float]
    """Its centre [m]."""
    clearance: PositiveNumber
    """From the centre to the inner faces of the walls [m]."""
    height: PositiveNumber
    """Of the walls [m]."""
    thickness: PositiveNumber
    """Of the walls [m]."""


class CellFile(_Asset):
    """cells/*.yaml."""

    mount: AssetName
    arms: dict[ArmSide, ArmFile]
    gravity: Triple
    """[m/s^2]"""
    tool_rest: ToolRestFile | None = None

    @model_validator(mode="after")
    def _both_arms_are_there(self) -> Self:
        _require_both_arms(self.arms)
        return self


def _require_both_arms(arms: Mapping[ArmSide, object]) -> None:
    missing = [name for name in ARM_NAMES if name not in arms]
    if missing:
        raise ValueError(f"arms.{missing[0]} is required")


_HAND_KINDS: dict[str, type[GripperFile | StickFile]] = {"gripper": GripperFile, "stick": StickFile}
_File = TypeVar("_File", bound=_Asset)


@dataclass(frozen=True)
class AssetShelf:
    """Folders of assets, searched in order: `<folder>/robots/<name>.yaml` and so on."""

    folders: tuple[Path, ...]

    def names(self, kind: str) -> list[str]:
        """List the names of all files of a kind ("robots", "hands", "sensors", "mounts", "cells", "tools")."""
        return sorted({path.stem for folder in self.folders for path in (folder / kind).glob("*.yaml")})

    def find(self, kind: str, name: str, where: str) -> Path:
        """Return the file of a name; `where` says which field asks for it.

        Raises:
            AssetError: There is none; the message lists those there are.
        """
        for folder in self.folders:
            path = folder / kind / f"{name}.yaml"
            if path.is_file():
                return path
        known = ", ".join(self.names(kind)) or "none"
        raise AssetError(f"{where}: no file {name!r} among the {kind}; there are: {known}")


def shipped_shelf() -> AssetShelf:
    """Return the assets that are part of the product."""
    return AssetShelf((assets_folder(),))


def fingerprint(contents: Iterable[bytes]) -> str:
    """Return a hash of contents in this order, the same on every machine."""
    digest = hashlib.sha256()
    for content in contents:
        digest.update(hashlib.sha256(content).digest())
    return digest.hexdigest()


def read_cell_file(path: Path) -> CellFile:
    """Read cells/*.yaml."""
    return _validated(CellFile, path, _read_mapping(path))


def read_mount_file(path: Path) -> MountFile:
    """Read mounts/*.yaml."""
    return _validated(MountFile, path, _read_mapping(path))


def read_robot_file(path: Path) -> RobotFile:
    """Read robots/*.yaml."""
    return _validated(RobotFile, path, _read_mapping(path))


def read_hand_file(path: Path) -> GripperFile | StickFile:
    """Read hands/*.yaml."""
    data = _read_mapping(path)
    kind = data.get("kind")
    if not isinstance(kind, str) or kind not in _HAND_KINDS:
        raise AssetError(f"{path}: kind: must be one of {', '.join(sorted(_HAND_KINDS))}")
    return _validated(_HAND_KINDS[kind], path, data)


def read_sensor_file(path: Path) -> SensorFile:
    """Read sensors/*.yaml."""
    return _validated(SensorFile, path, _read_mapping(path))


def known_meshes() -> list[str]:
    """List the names of the meshes that are shipped."""
    return sorted(path.stem for path in (assets_folder() / MESHES).glob("*.obj"))


def read_mesh_asset(name: str) -> tuple[bytes, Literal["obj"]]:
    """Return a shipped mesh's file, in metres, and its format.

    Raises:
        AssetError: There is none of this name.
    """
    path = assets_folder() / MESHES / f"{name}.obj"
    try:
        return path.read_bytes(), "obj"
    except OSError as error:
        raise AssetError(f"{path}: cannot be read: {error.strerror}") from error


def read_tool_file(path: Path) -> ToolFile:
    """Read tools/*.yaml."""
    return _validated(ToolFile, path, _read_mapping(path))


def _read_mapping(path: Path) -> dict[str, Any]:
    try:
        data = yaml.safe_load(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise AssetError(f"{path}: cannot be read: {error.strerror}") from error
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise AssetError(f"{path}: is not YAML: {error}") from error
    if not isinstance(data, dict):
        raise AssetError(f"{path}: must be a mapping of fields")
    return data


def _validated(model: type[_File], path: Path, data: dict[str, Any]) -> _File:
    """Validate as JSON: there, and only there, does strict mode accept arrays for tuples."""
    try:
        document = json.dumps(data)
    except TypeError as error:
        raise AssetError(f"{path}: holds something that is neither number, text, list nor mapping: {error}") from error
    try:
        file = model.model_validate_json(document)
    except ValidationError as error:
        faults = "; ".join(_sentence(fault["loc"], fault["msg"]) for fault in error.errors())
        raise AssetError(f"{path}: {faults}") from error
    if file.name != path.stem:
        raise AssetError(f"{path}: name: must be that of the file, {path.stem!r}")
    return file


def _sentence(location: tuple[int | str, ...], message: str) -> str:
    # Steps in brackets are pydantic's own: a key of a mapping, a kind among several.
    field = ".".join(str(step) for step in location if not str(step).startswith("["))
    text = message.replace("Input should be", "must be").replace("Field required", "is required")
    text = text.replace("Extra inputs are not permitted", "is not known here").removeprefix("Value error, ")
    return f"{field}: {text}" if field else text


def mesh_path(mesh: MeshFile) -> Path:
    """Return where an installed package keeps a mesh, without importing the package.

    Raises:
        AssetError: The package is not installed or has no such file.
    """
    spec = find_spec(mesh.package)
    if spec is None or not spec.submodule_search_locations:
        raise AssetError(f"the package {mesh.package!r} is not installed; it ships {mesh.path}")
    file = Path(spec.submodule_search_locations[0]) / mesh.path
    if not file.is_file():
        raise AssetError(f"the package {mesh.package!r} ships no {mesh.path}")
    return file


def hull_points(mesh: MeshFile) -> Array:
    """Return the corners (n, 3) of the convex hull of an OBJ file, in its own frame [m].

    Raises:
        AssetError: There is no such file, or it spans no volume.
    """
    path = mesh_path(mesh)
    try:
        points = obj_vertices(path.read_bytes()) * mesh.scale
        return points[ConvexHull(points).vertices]
    except (QhullError, ValueError) as error:
        raise AssetError(f"{mesh.path} of the package {mesh.package!r} spans no volume") from error
