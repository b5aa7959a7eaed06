"""What an arm carries at its flange: a parallel gripper, or a stick to push with, either on a force-torque sensor."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, Literal, Self

import numpy as np

from planners.cell.asset_files import BoxFile, GripperFile, HandFile, JawsFile, MeshFile, SensorFile, StickFile
from planners.cell.asset_shelf import AssetShelf, fingerprint, part_names, read_hand_file, read_sensor_file
from planners.errors import AssetError, AssetFault, AssetFaults, LiftwrightError
from planners.geometry.convex import CollisionBody, ConvexShape, box, capsule, cylinder, enclosing_hull
from planners.geometry.pose import Array, Transform, rotation_x, rotation_z, transform
from planners.plan.scenery import GripperDocument, StickDocument

TCP_STEP = 1e-3
"""Steps of a gripper's TCP table [m]: interpolated linearly between them, the TCP is right to 2 micrometres."""

FINGER_SIDES = (rotation_z(math.pi), np.eye(3))
"""Turns of finger 0, at -y, and finger 1 against the finger at +y that a hand file describes."""


class WidthError(LiftwrightError):
    """An opening is asked for that the gripper does not have."""

    def __init__(self, name: str, width: float, width_max: float) -> None:
        """Name the gripper, what was asked for and its stroke [m]."""
        super().__init__(f"{name} cannot open to {width} m: 0 to {width_max} m")


@dataclass(frozen=True, eq=False)
class Linkage:
    """A parallel finger: a four-bar whose crank turns by q and whose pad never tilts.

    Joint origins (y, z) of the finger at +y, fully open, in the gripper's base frame: y away from the middle, z away
    from the flange. With the sums `y = outer_knuckle + pad - half the pad's thickness` and `c = outer_finger +
    inner_finger`, the pad's inner face is at `y + c_y cos q - c_z sin q` and its centre at the height
    `z + c_y sin q + c_z cos q`.
    """

    outer_knuckle: Array
    outer_finger: Array
    inner_finger: Array
    pad: Array
    inner_knuckle: Array
    pad_thickness: float
    """[m]"""

    @property
    def _crank(self) -> Array:
        return self.outer_finger + self.inner_finger

    def angle(self, width: float) -> float:
        """Return the crank angle q at which the inner faces of the two pads are `width` apart [rad]."""
        half_gap = 0.5 * width - (self.outer_knuckle[0] + self.pad[0] - 0.5 * self.pad_thickness)
        y, z = self._crank
        return math.acos(half_gap / math.hypot(y, z)) - math.atan2(z, y)

    def frames(self, width: float) -> dict[str, Transform]:
        """Return `T_base_part` of the parts of the finger at +y, its pad among them, at an opening [m]."""
        turn = rotation_x(self.angle(width))
        outer_knuckle = transform(turn, [0.0, *self.outer_knuckle])
        outer_finger = outer_knuckle @ transform(None, [0.0, *self.outer_finger])
        inner_finger = outer_finger @ transform(turn.T, [0.0, *self.inner_finger])
        return {
            "outer_knuckle": outer_knuckle,
            "outer_finger": outer_finger,
            "inner_finger": inner_finger,
            "inner_knuckle": transform(turn, [0.0, *self.inner_knuckle]),
            "pad": inner_finger @ transform(None, [0.0, *self.pad]),
        }


@dataclass(frozen=True, eq=False)
class Jaws:
    """A finger that slides along y, as one piece."""

    pad: Array
    """(2,) centre (y, z) of the pad of the finger at +y when closed, in the gripper's base frame [m]."""
    parts: tuple[str, ...]
    """Names of what slides with the pad; their frames are the base frame when closed."""

    def frames(self, width: float) -> dict[str, Transform]:
        """Return `T_base_part` of the parts of the finger at +y, its pad among them, at an opening [m]."""
        slid = transform(None, [0.0, 0.5 * width, 0.0])
        return {**dict.fromkeys(self.parts, slid), "pad": slid @ transform(None, [0.0, *self.pad])}


@dataclass(frozen=True, eq=False)
class Gripper:
    """Two parallel fingers that open along the flange's y axis; finger 0 is at -y.

    The TCP is the midpoint between the pad centres at the current width, with the flange's axes: z approaches,
    y opens. Where the fingers are a linkage it moves along z as the gripper opens.
    """

    name: str
    width_max: float
    """Largest distance of the pads' inner faces [m]."""
    pad_size: Array
    """(3,) width along x, thickness along y, length along z [m]."""
    force_min: float
    """[N]"""
    force_max: float
    squeeze: float
    """[N]"""
    mass: float
    """Gripper and sensor [kg]."""
    com: Array
    """(3,) of gripper and sensor, in the flange frame [m]."""
    sensor: ConvexShape | None
    """In the flange frame; None: it has none."""
    base_height: float
    """Where the gripper's base frame is on the flange's z axis; its axes are the flange's [m]."""
    fingers: Linkage | Jaws
    base: ConvexShape
    """Few vertices around the mesh, in the base frame."""
    finger_parts: dict[str, ConvexShape]
    """By name, as `fingers` moves them, without the pad; each in its own frame."""
    fingerprint: str
    """Hash of the files it was loaded from, meshes included."""

    kind: ClassVar[Literal["gripper"]] = "gripper"

    def T_flange_tcp(self, width: float) -> Transform:
        """Return `T_flange_tcp` at an opening [m].

        Raises:
            WidthError: The gripper does not open so far.
        """
        return transform(None, [0.0, 0.0, self.base_height + self._frames(width)["pad"][2, 3]])

    def palm_distance(self, width: float) -> float:
        """Return how far the pads' centres are from the farthest point of the base at an opening [m].

        Raises:
            WidthError: The gripper does not open so far.
        """
        return float(self._frames(width)["pad"][2, 3] - self.base.vertices[:, 2].max() - self.base.radius)

    @cached_property
    def tcp_table(self) -> Array:
        """(n, 2) rows of opening and height of the TCP above the flange, to interpolate linearly [m]."""
        steps = math.ceil(self.width_max / TCP_STEP)
        widths = np.linspace(0.0, self.width_max, steps + 1)
        return np.column_stack([widths, [self.T_flange_tcp(float(width))[2, 3] for width in widths]])

    @cached_property
    def pad(self) -> ConvexShape:
        """One of both, about its centre."""
        return box(self.pad_size)

    def bodies(self, arm: str, width: float) -> tuple[CollisionBody, ...]:
        """Return the sensor, the base, and per finger its pad and its other parts, in the frame "<arm>/6".

        Args:
            arm: name of the arm that carries the gripper.
            width: opening [m].

        Raises:
            WidthError: The gripper does not open so far.
        """
        shapes: dict[str, ConvexShape | None] = {
            "ft300": self.sensor,
            "gripper_base": self.base.placed(self._T_flange_base),
        }
        for finger, frames in enumerate(self._finger_frames(width)):
            shapes[f"pad_{finger}"] = self.pad.placed(frames["pad"])
            for name, part in self.finger_parts.items():
                shapes[f"finger_{finger}_{name}"] = part.placed(frames[name])
        return _bodies(arm, shapes)

    def document(self) -> GripperDocument:
        """Return the entry of a plan's `cell.hands`."""
        forces = self.force_min, self.force_max
        return GripperDocument(kind="gripper", mass=self.mass, com=self.com, tcp=self.tcp_table, force_range=forces)

    @property
    def _T_flange_base(self) -> Transform:
        return transform(None, [0.0, 0.0, self.base_height])

    def _frames(self, width: float) -> dict[str, Transform]:
        if not 0.0 <= width <= self.width_max:
            raise WidthError(self.name, width, self.width_max)
        return self.fingers.frames(width)

    def _finger_frames(self, width: float) -> list[dict[str, Transform]]:
        """Return `T_flange_part` of each part of both fingers."""
        frames = self._frames(width)
        sides = [self._T_flange_base @ transform(side) for side in FINGER_SIDES]
        return [{name: T_flange_side @ T for name, T in frames.items()} for T_flange_side in sides]


@dataclass(frozen=True, eq=False)
class Pusher:
    """A stick along the flange's z axis that pushes with its round tip.

    The TCP is the centre of the tip's hemisphere, with the flange's axes: the contact point on a surface with the
    inward normal n is `tcp + tip_radius * n`.
    """

    name: str
    T_flange_tcp: Transform
    tip_radius: float
    """[m]"""
    mass: float
    """Stick and sensor [kg]."""
    com: Array
    """(3,) of stick and sensor, in the flange frame [m]."""
    sensor: ConvexShape | None
    """In the flange frame; None: it has none."""
    stick: ConvexShape
    """Capsule that ends short of the tip, in the flange frame: it never touches what the tip touches."""
    tip: ConvexShape
    """Capsule that may touch, in the flange frame; one end is the tip's hemisphere."""
    fingerprint: str
    """Hash of the files it was loaded from, meshes included."""

    kind: ClassVar[Literal["stick"]] = "stick"

    def bodies(self, arm: str) -> tuple[CollisionBody, ...]:
        """Return the sensor, the stick and the tip, in the frame "<arm>/6"."""
        return _bodies(arm, {"ft300": self.sensor, "stick": self.stick, "tip": self.tip})

    def document(self) -> StickDocument:
        """Return the entry of a plan's `cell.hands`."""
        tcp = np.array([*self.T_flange_tcp[:3, 3], 1.0, 0.0, 0.0, 0.0])
        return StickDocument(kind="stick", mass=self.mass, com=self.com, tcp=tcp, tip_radius=self.tip_radius)


@dataclass(frozen=True, eq=False)
class _Sensor:
    """What is between the flange and a hand."""

    length: float
    """[m]"""
    mass: float
    """[kg]"""
    shape: ConvexShape | None
    """In the flange frame; None: there is nothing."""
    contents: tuple[bytes, ...]

    @classmethod
    def of(cls, file: SensorFile) -> Self:
        """Take a sensor as its file describes it."""
        shape = cylinder(file.radius, file.length).placed(transform(None, [0.0, 0.0, 0.5 * file.length]))
        return cls(file.length, file.mass, shape, (file.model_dump_json().encode(),))


_NO_SENSOR = _Sensor(0.0, 0.0, None, ())


def load_hand(name: str, shelf: AssetShelf) -> Gripper | Pusher:
    """Load hands/<name>.yaml with its meshes.

    Args:
        name: name of the hand.
        shelf: where to look.

    Raises:
        AssetError: A file is missing or wrong.
    """
    path = shelf.find("hands", name)
    faults, file, sensor = AssetFaults(), None, _NO_SENSOR
    with faults.at(str(path)):
        file = read_hand_file(path)
    for member, named in part_names("hands", path).items():
        with faults.at(str(path), f"/{member}"):
            sensor = _Sensor.of(read_sensor_file(shelf.find("sensors", named)))
    if file is None or faults.found:
        raise AssetError(*faults.found)
    match file:
        case GripperFile():
            return _linked_gripper(file, sensor, shelf, str(path))
        case JawsFile():
            return _jaws(file, sensor)
        case StickFile():
            return _pusher(file, sensor, str(path))


def _linked_gripper(file: GripperFile, sensor: _Sensor, shelf: AssetShelf, path: str) -> Gripper:
    origins = {name: np.array(origin) for name, origin in file.linkage.model_dump().items()}
    meshes = {name: getattr(file.meshes, name) for name in type(file.meshes).model_fields}
    linkage = Linkage(**origins, pad_thickness=file.pad_size[1])
    faults = AssetFaults()
    with faults.at(path):
        _check_stroke(linkage, file.width_max, path)
    parts = _finger_parts(meshes, shelf, path, faults)
    faults.raise_any()
    contents = [*_contents(file, sensor), *(shelf.mesh_path(mesh).read_bytes() for mesh in meshes.values())]
    return _gripper(file, sensor, linkage, parts, contents)


def _jaws(file: JawsFile, sensor: _Sensor) -> Gripper:
    parts = {name: _box(each) for name, each in {"base": file.base, **file.finger}.items()}
    pad = np.array([0.5 * file.pad_size[1], file.pad_height])
    return _gripper(file, sensor, Jaws(pad, tuple(file.finger)), parts, _contents(file, sensor))


def _gripper(
    file: GripperFile | JawsFile,
    sensor: _Sensor,
    fingers: Linkage | Jaws,
    parts: dict[str, ConvexShape],
    contents: list[bytes],
) -> Gripper:
    return Gripper(
        name=file.name,
        width_max=file.width_max,
        pad_size=np.array(file.pad_size),
        force_min=file.force_range[0],
        force_max=file.force_range[1],
        squeeze=file.squeeze,
        mass=file.mass + sensor.mass,
        com=np.array([0.0, 0.0, file.com]),
        sensor=sensor.shape,
        base_height=sensor.length,
        fingers=fingers,
        base=parts.pop("base"),
        finger_parts=parts,
        fingerprint=fingerprint(contents),
    )


def _box(file: BoxFile) -> ConvexShape:
    return box(file.size).placed(transform(None, file.center))


def _check_stroke(linkage: Linkage, width_max: float, path: str) -> None:
    for width in (0.0, width_max):
        try:
            linkage.angle(width)
        except ValueError as error:
            raise AssetError(AssetFault(f"the pads are never {width} m apart", path, "/linkage")) from error


def _pusher(file: StickFile, sensor: _Sensor, path: str) -> Pusher:
    center = file.tip_distance - file.tip_radius
    neck = center - file.tip_length
    if neck <= sensor.length:
        least = 1e3 * (sensor.length + file.tip_length + file.tip_radius)
        detail = f"leaves no stick between the sensor and the tip: more than {least:.1f} mm are needed"
        raise AssetError(AssetFault(detail, path, "/tip_distance"))
    return Pusher(
        name=file.name,
        T_flange_tcp=transform(None, [0.0, 0.0, center]),
        tip_radius=file.tip_radius,
        mass=file.mass + sensor.mass,
        com=np.array([0.0, 0.0, file.com]),
        sensor=sensor.shape,
        stick=capsule([0.0, 0.0, sensor.length], [0.0, 0.0, neck], file.stick_radius),
        tip=capsule([0.0, 0.0, neck], [0.0, 0.0, center], file.tip_radius),
        fingerprint=fingerprint(_contents(file, sensor)),
    )


def _contents(file: HandFile, sensor: _Sensor) -> list[bytes]:
    return [file.model_dump_json().encode(), *sensor.contents]


def _finger_parts(
    meshes: Mapping[str, MeshFile], shelf: AssetShelf, path: str, faults: AssetFaults
) -> dict[str, ConvexShape]:
    parts = dict[str, ConvexShape]()
    for name, mesh in meshes.items():
        with faults.at(path, f"/meshes/{name}"):
            parts[name] = ConvexShape(enclosing_hull(shelf.hull_points(mesh)))
    return parts


def _bodies(arm: str, shapes: Mapping[str, ConvexShape | None]) -> tuple[CollisionBody, ...]:
    there = ((name, shape) for name, shape in shapes.items() if shape is not None)
    return tuple(CollisionBody(f"{arm}_{name}", arm, f"{arm}/6", (shape,)) for name, shape in there)
