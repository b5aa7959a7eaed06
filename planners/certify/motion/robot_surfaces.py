"""The robots' surfaces: convex hulls of the makers' meshes, unreduced, and of what stands in where there are none.

Read here a second time and in another way than the cell does: by readers of the certificate's own, and by pinocchio on
the URDF where the makers' meshes come with one, so that a mesh the planners have put in the wrong place is found.
"""

# pinocchio has no type stubs for what its compiled part exports.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from importlib.util import find_spec
from pathlib import Path
from typing import TypeVar

import numpy as np
import pinocchio as pin
import yaml
from pydantic import BaseModel, ValidationError
from scipy.spatial.transform import Rotation

from assets import assets_folder
from planners.certify.geometry.body_shape import ConvexPart, box, convex_part, cylinder
from planners.certify.motion.kinematics import ArmKinematics
from planners.certify.motion.robot_files import (
    BoxRecord,
    CylinderRecord,
    GripperRecord,
    HandRecord,
    JawsRecord,
    LinkageRecord,
    LinkRecord,
    MeshRecord,
    RobotRecord,
    SensorRecord,
    StickRecord,
)
from planners.errors import AssetError
from planners.geometry.pose import Array, Transform, frame_from_z, inverse, rotation_x, transform
from planners.plan.scenery import ARMS

LINKS = ("base", "shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3")
_LABORATORY = {arm: ("ur3e", "robotiq_2f85_ft300") for arm in ARMS}
_STICK = "pushing_stick_ft300"
"""Of the papers, whose arms carry the one hand or the other."""


@dataclass(frozen=True, eq=False)
class FourBar:
    """Finger 1, at +y, as a linkage whose pad never tilts; in the gripper's base frame."""

    pad_face: float
    """How far the pad's inner face is from the middle, less what the finger's crank adds [m]."""
    knuckle_pivot: Array
    """(3,) [m]; `inner_pivot` likewise."""
    inner_pivot: Array
    outer_finger: Array
    """(3,) from the knuckle's pivot, fully open; `inner_finger` likewise [m]."""
    inner_finger: Array
    pad: Array
    """(3,) centre of the pad, from the inner finger's joint [m]."""
    far: Mapping[str, float]
    """Of each part: how far its farthest point is from its own origin [m]."""

    @property
    def largest_width(self) -> float:
        """Inner distance of the pads at the open stop [m]."""
        return 2 * float(self.pad_face + self.inner_finger[1])

    @cached_property
    def reach(self) -> float:
        """No point of a finger is farther from the axis it turns about [m]."""
        arm = float(np.linalg.norm(self.inner_finger))
        from_pivot = {
            "outer_knuckle": 0.0,
            "inner_knuckle": 0.0,
            "outer_finger": float(np.linalg.norm(self.outer_finger)),
            "inner_finger": arm,
            "pad": arm + float(np.linalg.norm(self.pad)),
        }
        return max(from_pivot[part] + far for part, far in self.far.items())

    def extent(self, height: float) -> float:
        """Return what no point of a finger is farther from the flange's origin than, so far below the base [m]."""
        lift = np.array([0.0, 0.0, height])
        return self.reach + max(float(np.linalg.norm(lift + pivot)) for pivot in (self.knuckle_pivot, self.inner_pivot))

    def travel(self, widths: Array) -> Array:
        """Return how far any point of a finger moves from opening to opening: (n,) [m] → (n - 1,) [m]."""
        return self.reach * self.turns(widths)

    def turns(self, widths: Array) -> Array:
        """Return by how much any part of a finger turns from opening to opening: (n,) [m] → (n - 1,) [rad]."""
        return np.abs(np.diff(self.angles(widths)))

    def angles(self, widths: Array) -> Array:
        """Return the finger joint's angle for each inner distance of the pads: [m] → [rad].

        gap = 2 (c + a cos q - b sin q), with a, b from the linkage and c from the pad; solved for q in closed form.
        """
        _, a, b = self.inner_finger
        cosine = np.clip((widths / 2 - self.pad_face) / math.hypot(a, b), -1.0, 1.0)
        return np.maximum(np.arccos(cosine) - math.atan2(b, a), 0.0)

    def poses(self, part: str, widths: Array) -> Array:
        """Return the poses of a part in the base frame at each opening: (n,) [m] → (n, 4, 4).

        The knuckles turn with the finger joint; finger and pad keep their orientation and travel on a circle.
        """
        poses = np.empty((len(widths), 4, 4))
        for index, angle in enumerate(self.angles(widths)):
            turn = rotation_x(float(angle))
            if part == "inner_knuckle":
                rotation, position = turn, self.inner_pivot
            elif part == "outer_knuckle":
                rotation, position = turn, self.knuckle_pivot
            elif part == "outer_finger":
                rotation, position = turn, self.knuckle_pivot + turn @ self.outer_finger
            else:
                rotation, position = np.eye(3), self.knuckle_pivot + turn @ self.inner_finger
                if part == "pad":
                    position = position + self.pad
            poses[index] = transform(rotation, position)
        return poses


@dataclass(frozen=True, eq=False)
class Slide:
    """Finger 1, at +y, as a jaw that slides along y; in the gripper's base frame."""

    largest_width: float
    """Stroke: inner distance of the pads at the open stop [m]."""
    pad: Array
    """(3,) centre of the pad when closed [m]."""
    far: Mapping[str, float]
    """Of each part: how far its farthest point is from its own origin, which is the base frame's when closed [m]."""

    def extent(self, height: float) -> float:
        """Return what no point of a finger is farther from the flange's origin than, so far below the base [m]."""
        return height + self.largest_width / 2 + float(np.linalg.norm(self.pad)) + max(self.far.values())

    def travel(self, widths: Array) -> Array:
        """Return how far any point of a finger moves from opening to opening: (n,) [m] → (n - 1,) [m]."""
        return np.abs(np.diff(widths)) / 2

    def turns(self, widths: Array) -> Array:
        """Return by how much any part of a finger turns from opening to opening: not at all, (n,) → (n - 1,) [rad]."""
        return np.zeros(len(widths) - 1)

    def poses(self, part: str, widths: Array) -> Array:
        """Return the poses of a part in the base frame at each opening: (n,) [m] → (n, 4, 4)."""
        poses = np.tile(np.eye(4), (len(widths), 1, 1))
        poses[:, 1, 3] = widths / 2
        if part == "pad":
            poses[:, :3, 3] += self.pad
        return poses


@dataclass(frozen=True, eq=False)
class GripperSurfaces:
    """A gripper of two parallel fingers; in the flange frame, they open along y."""

    base: ConvexPart
    finger_parts: Mapping[str, ConvexPart]
    """Parts of finger 1 in their own frames, see `finger_poses`; finger 0 is finger 1 turned half about z."""
    pad_size: Array
    """(3,) width of its inner face, thickness, length of the face [m]."""
    height: float
    """Of the gripper's base frame above the flange [m]."""
    fingers: FourBar | Slide

    @cached_property
    def extent(self) -> float:
        """No point of a finger is farther from the flange's origin [m]."""
        return self.fingers.extent(self.height)

    def finger_poses(self, part: str, finger: int, widths: Array) -> Array:
        """Return the poses of a finger's part in the flange frame at each opening: (n,) [m] → (n, 4, 4)."""
        T_flange_side = np.diag([-1.0, -1.0, 1.0, 1.0]) if finger == 0 else np.eye(4)
        T_flange_side[2, 3] = self.height
        return T_flange_side @ self.fingers.poses(part, widths)

    def pad_height(self, widths: Array) -> Array:
        """Return the height of the pads' centres above the flange at each opening [m]."""
        return self.finger_poses("pad", 1, widths)[:, 2, 3]


@dataclass(frozen=True)
class StickSurfaces:
    """A stick, all of it about the flange's z axis; heights are above the flange [m]."""

    neck: float
    """Where what may touch begins."""
    tip: float
    """Of the centre of the tip's hemisphere."""
    stick_radius: float
    tip_radius: float


@dataclass(frozen=True, eq=False)
class ArmSurfaces:
    """Hulls of one arm's links, of the sensor on its flange and of the gripper's parts."""

    links: tuple[tuple[ConvexPart, ...], ...]
    """Seven links of one hull or more; number i in the frame after i joints (0 = base)."""
    sensor: ConvexPart | None
    """In the flange frame; None: the hand has none."""
    sensor_length: float
    """Coupling and sensor, from the flange to the base of gripper or stick [m]."""
    gripper: GripperSurfaces | None
    """None: it has none."""
    stick: StickSurfaces | None
    """None: it has none."""


RobotSurfaces = Mapping[str, ArmSurfaces]
"""By arm."""


def load_surfaces(
    arms: Mapping[str, tuple[str, str]] | None = None, folders: Sequence[Path] | None = None
) -> RobotSurfaces:
    """Read the shapes of a cell's arms and hands.

    Args:
        arms: names of robot and hand by arm; None takes the papers' UR3e with 2F-85 and stick, whichever a plan has.
        folders: where `robots/`, `hands/` and `sensors/` are looked for, in order; None takes the shipped ones.

    Raises:
        AssetError: A file or a mesh is missing, or has no volume.
    """
    reader = _AssetReader(tuple(folders or (assets_folder(),)))
    # Both arms may be of one kind.
    read = {kind: reader.arm(*kind) for kind in set((arms or _LABORATORY).values())}
    if arms is None:
        read = {kind: replace(known, stick=reader.arm(kind[0], _STICK).stick) for kind, known in read.items()}
    return {arm: read[kind] for arm, kind in (arms or _LABORATORY).items()}


_Record = TypeVar("_Record", bound=BaseModel)


@dataclass(frozen=True)
class _AssetReader:
    folders: tuple[Path, ...]

    def arm(self, robot: str, hand: str) -> ArmSurfaces:
        held = self._read("hands", hand, HandRecord).root
        sensor = None if held.sensor is None else self._read("sensors", held.sensor, SensorRecord)
        length = 0.0 if sensor is None else sensor.length
        return ArmSurfaces(
            links=self._links(robot),
            sensor=None if sensor is None else _sensor(sensor),
            sensor_length=length,
            gripper=None if isinstance(held, StickRecord) else self._gripper(held, length),
            stick=_stick(held) if isinstance(held, StickRecord) else None,
        )

    def _links(self, robot: str) -> tuple[tuple[ConvexPart, ...], ...]:
        described = self._read("robots", robot, RobotRecord)
        if described.links_of is not None:
            robot = described.links_of
            described = self._read("robots", robot, RobotRecord)
        drawn = {link.name: link for link in described.links}
        # A file of somebody's own may put the same meshes elsewhere: its word counts, and not that of their package.
        shipped = self._path_of("robots", robot).is_relative_to(assets_folder())
        urdf = self._urdf_of(drawn.values()) if shipped else None
        if urdf is not None:
            rows = [[joint.a, joint.alpha_deg, joint.d, joint.theta0_deg] for joint in described.joints]
            dh = np.array(rows) * [1.0, math.pi / 180.0, 1.0, math.pi / 180.0]
            return tuple((hull,) for hull in _link_hulls(urdf, dh))
        return tuple(self._link(drawn[name]) for name in LINKS)

    def _read(self, kind: str, name: str, record: type[_Record]) -> _Record:
        try:
            return record.model_validate(yaml.safe_load(self._path_of(kind, name).read_text(encoding="utf-8")))
        except ValidationError as error:
            raise AssetError(f"{kind}/{name}.yaml cannot be read: {error}") from error

    def _path_of(self, kind: str, name: str) -> Path:
        paths = (folder / kind / f"{name}.yaml" for folder in self.folders)
        found = next((path for path in paths if path.is_file()), None)
        if found is None:
            raise AssetError(f"there is no {kind}/{name}.yaml")
        return found

    def _gripper(self, held: GripperRecord | JawsRecord, height: float) -> GripperSurfaces:
        pad_size = np.array(held.pad_size)
        if isinstance(held, JawsRecord):
            base = _box(held.base)
            parts = {name: convex_part(_box(described)) for name, described in held.finger.items()}
        else:
            base = self._mesh_vertices(held.meshes.base)
            parts = {name: _hull(self._mesh_vertices(mesh), name) for name, mesh in held.meshes.finger.items()}
        parts["pad"] = box(pad_size).parts[0]
        far = {part: float(np.linalg.norm(hull.vertices, axis=1).max()) for part, hull in parts.items()}
        if isinstance(held, JawsRecord):
            fingers = Slide(held.width_max, np.array([0.0, pad_size[1] / 2, held.pad_height]), far)
        else:
            fingers = _four_bar(held.linkage, pad_size, far)
        return GripperSurfaces(_hull(np.add(base, [0.0, 0.0, height]), "base"), parts, pad_size, height, fingers)

    def _link(self, described: LinkRecord) -> tuple[ConvexPart, ...]:
        if described.mesh is not None:
            turn = Rotation.from_euler("xyz", described.rpy_deg, degrees=True).as_matrix()
            return (_hull(self._mesh_vertices(described.mesh) @ turn.T + described.position, described.name),)
        pieces = tuple(_hull(np.array(corners), described.name) for corners in described.pieces)
        return pieces or tuple(map(_cylinder, described.cylinders))

    def _urdf_of(self, links: Collection[LinkRecord]) -> Path | None:
        """Return the folder of a URDF whose meshes all the links have, if there is one."""
        folders = {self._file_of(link.mesh).parent.parent for link in links if link.mesh is not None}
        if len(folders) != 1 or any(link.mesh is None for link in links):
            return None
        (folder,) = folders
        return folder if (folder / f"{folder.name}.urdf").is_file() else None

    def _file_of(self, mesh: MeshRecord) -> Path:
        """Return the file of a mesh of the cell, or of one that an installed package ships, which is not imported."""
        if mesh.package is None:
            found = next((folder / mesh.path for folder in self.folders if (folder / mesh.path).is_file()), None)
            if found is None:
                raise AssetError(f"there is no file {mesh.path}")
            return found
        spec = find_spec(mesh.package)
        if spec is None or not spec.submodule_search_locations:
            raise AssetError(f"the package {mesh.package!r} is not installed; it ships {mesh.path}")
        return Path(spec.submodule_search_locations[0]) / mesh.path

    def _mesh_vertices(self, mesh: MeshRecord) -> Array:
        return mesh.scale * _vertices(self._file_of(mesh))


def _sensor(described: SensorRecord) -> ConvexPart:
    around = cylinder(described.radius, described.length).parts[0].vertices
    return convex_part(np.add(around, [0.0, 0.0, described.length / 2]))


def _stick(held: StickRecord) -> StickSurfaces:
    centre = held.tip_distance - held.tip_radius
    return StickSurfaces(centre - held.tip_length, centre, held.stick_radius, held.tip_radius)


def _box(described: BoxRecord) -> Array:
    """Return the corners of a box along the axes of its frame: (8, 3) [m]."""
    return np.add(box(np.array(described.size)).parts[0].vertices, described.center)


def _four_bar(linkage: LinkageRecord, pad_size: Array, far: Mapping[str, float]) -> FourBar:
    knuckle, outer_finger, pad = (
        np.array([0.0, *offset]) for offset in (linkage.outer_knuckle, linkage.outer_finger, linkage.pad)
    )
    return FourBar(
        pad_face=float(knuckle[1] + pad[1] - pad_size[1] / 2),
        knuckle_pivot=knuckle,
        inner_pivot=np.array([0.0, *linkage.inner_knuckle]),
        outer_finger=outer_finger,
        inner_finger=outer_finger + np.array([0.0, *linkage.inner_finger]),
        pad=pad,
        far=far,
    )


def _cylinder(described: CylinderRecord) -> ConvexPart:
    axis = np.subtract(described.end, described.start)
    centre = np.add(described.start, described.end) / 2
    T = transform(frame_from_z(axis, np.eye(3)[int(np.argmin(np.abs(axis)))]), centre)
    upright = cylinder(described.radius, float(np.linalg.norm(axis))).parts[0]
    return convex_part(upright.vertices @ T[:3, :3].T + T[:3, 3])


def _link_hulls(folder: Path, dh: Array) -> list[ConvexPart]:
    """Take the meshes from where the URDF places them at zero to the frames of the contract."""
    # The URDF uses the prefix `drake:` undeclared, and shows the base with its cable, 0.34 m of it.
    text = (folder / f"{folder.name}.urdf").read_text()
    text = (
        text.replace("drake:", "").replace("visual/base_cable_labels", "visual/base").replace("visual/", "collision/")
    )
    model = pin.buildModelFromXML(text)
    geometry = pin.buildGeomFromUrdfString(model, text, pin.GeometryType.VISUAL, package_dirs=[str(folder)])
    data, geometry_data = model.createData(), geometry.createData()
    pin.updateGeometryPlacements(model, data, geometry, geometry_data, pin.neutral(model))
    pin.updateFramePlacements(model, data)
    # The URDF's root is the ROS base_link, half a turn about z from the controller's base.
    T_base_root = inverse(data.oMf[model.getFrameId("base")].homogeneous)
    frames = ArmKinematics(dh, np.eye(4)).frames(np.zeros((1, 6)))[0]
    hulls = []
    for index, link in enumerate(LINKS):
        mesh = link.replace("_", "")
        shape = geometry.getGeometryId(("base_link_inertia" if index == 0 else f"{link}_link") + "_0")
        T_link_mesh: Transform = inverse(frames[index]) @ T_base_root @ geometry_data.oMg[shape].homogeneous
        vertices = _vertices(folder / "collision" / f"{mesh}.obj") @ T_link_mesh[:3, :3].T + T_link_mesh[:3, 3]
        hulls.append(_hull(vertices, mesh))
    return hulls


def _vertices(path: Path) -> Array:
    """Return the vertices (n, 3) of a mesh in their order."""
    # Takes a third of a second to import, and is needed when there is a plan to certify.
    import trimesh

    try:
        return np.asarray(trimesh.load_mesh(path, process=False, maintain_order=True, skip_materials=True).vertices)
    except (OSError, ValueError) as error:
        raise AssetError(f"{path.name} cannot be read: {error}") from error


def _hull(vertices: Array, name: str) -> ConvexPart:
    try:
        return convex_part(vertices)
    except ValueError as error:
        raise AssetError(f"mesh {name}: {error}") from error
