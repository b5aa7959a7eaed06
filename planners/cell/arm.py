"""An arm: the robot as it comes from its maker, mounted somewhere, with a hand."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from planners.cell.asset_files import (
    CylinderFile,
    CylinderLinkFile,
    LinkFile,
    LinkName,
    MeshLinkFile,
    PiecesLinkFile,
    RobotFile,
)
from planners.cell.asset_shelf import AssetShelf, fingerprint, read_robot_file
from planners.cell.hand import Gripper, Pusher
from planners.errors import AssetError, AssetFault, AssetFaults
from planners.geometry.convex import CollisionBody, ConvexShape, cylinder, enclosing_hull
from planners.geometry.pose import Array, Transform, frame_from_z, pose_row, transform
from planners.kinematics.arm_kind import NoClosedForm, arm_kind
from planners.kinematics.joint_torque import WeighedArm
from planners.plan.scenery import ArmDocument, LinkDocument

CYLINDER_SIDES = 12
"""Of the prism around a cylinder of a link: at most 3.5 % of its radius too large."""


@dataclass(frozen=True, eq=False)
class Link:
    """A rigid link, in the frame after as many joints as there are before it."""

    name: LinkName
    pieces: tuple[Array, ...]
    """(n, 3) corners of each convex piece: the hull of the mesh, one cylinder each, or as the file has them [m]."""
    shapes: tuple[ConvexShape, ...]
    """Few vertices around each of the `pieces`."""

    @property
    def points(self) -> Array:
        """(n, 3) corners of all pieces [m]."""
        return np.vstack(self.pieces)


@dataclass(frozen=True, eq=False)
class Robot:
    """An arm of six joints of which `arm_kind` knows the kind. Arrays of joint limits are (6,), in SI units."""

    name: str
    joint_names: tuple[str, ...]
    T_mount_base: Transform
    """The frame before the first joint, on the frame with which the arm is mounted."""
    dh: Array
    """(6, 4) columns a, alpha, d, theta0 [m, rad]."""
    position_min: Array
    position_max: Array
    velocity_max: Array
    acceleration_max: Array
    torque_max: Array
    links: tuple[Link, ...]
    """Link i moves with frame i: the base is 0, wrist 3 is 6."""
    masses: Array
    """(6, 4) of the links that move: mass [kg], and centre of mass in the frame after the link's joint [m]."""
    payload: float
    """Largest mass at the flange [kg]."""
    reach: float
    """As its maker states it [m]."""
    fingerprint: str
    """Hash of the files it was loaded from, meshes included."""


def table_of(file: RobotFile) -> Array:
    """Return the rows (6, 4) of a robot's table: a [m], alpha [rad], d [m], theta0 [rad]."""
    return np.array([[j.a, np.radians(j.alpha_deg), j.d, np.radians(j.theta0_deg)] for j in file.joints])


def load_robot(name: str, shelf: AssetShelf) -> Robot:
    """Load robots/<name>.yaml with its meshes.

    Args:
        name: name of the robot.
        shelf: where to look.

    Raises:
        AssetError: A file is missing or wrong, or its table is that of no kind of arm that has a closed form.
    """
    path = shelf.find("robots", name)
    file = read_robot_file(path)
    joints, dh = file.joints, table_of(file)
    faults, link_files, links = AssetFaults(), tuple[LinkFile, ...](), tuple[Link, ...]()
    if isinstance(kind := arm_kind(dh), NoClosedForm):
        faults.add(kind.reason, str(path), "/joints")
    with faults.at(str(path)):
        link_files = _link_files(file, shelf, path)
        links = _links(link_files, shelf, str(path))
    faults.raise_any()
    position = np.radians([j.position_deg for j in joints])
    return Robot(
        name=file.name,
        joint_names=tuple(j.name for j in joints),
        T_mount_base=np.eye(4) if file.base is None else file.base.transform(),
        dh=dh,
        position_min=np.ascontiguousarray(position[:, 0]),
        position_max=np.ascontiguousarray(position[:, 1]),
        velocity_max=np.radians([j.velocity_deg for j in joints]),
        acceleration_max=np.array([j.acceleration for j in joints]),
        torque_max=np.array([j.torque for j in joints]),
        links=links,
        masses=np.array([[link.mass, *link.com] for link in file.masses]),
        payload=file.payload,
        reach=file.reach,
        fingerprint=fingerprint(_contents(file, link_files, shelf)),
    )


def _links(files: tuple[LinkFile, ...], shelf: AssetShelf, path: str) -> tuple[Link, ...]:
    faults, links = AssetFaults(), list[Link]()
    for i, file in enumerate(files):
        with faults.at(path, f"/links/{i}"):
            links.append(_link(file, shelf))
    faults.raise_any()
    return tuple(links)


def _link_files(file: RobotFile, shelf: AssetShelf, path: Path) -> tuple[LinkFile, ...]:
    if file.links is not None:
        return file.links
    try:
        stand_in = read_robot_file(shelf.find("robots", str(file.links_of)))
    except AssetError as error:
        raise error.at(str(path), "/links_of") from error
    if stand_in.links is None:
        raise AssetError(AssetFault(f"{file.links_of!r} has no links of its own", str(path), "/links_of"))
    return stand_in.links


def _contents(file: RobotFile, links: tuple[LinkFile, ...], shelf: AssetShelf) -> Iterator[bytes]:
    # Plans state hashes from before files could say where the base is.
    yield file.model_dump_json(exclude={"base"} if file.base is None else None).encode()
    for link in links:
        yield link.model_dump_json().encode()
        if isinstance(link, MeshLinkFile):
            yield shelf.mesh_path(link.mesh).read_bytes()


def _link(file: LinkFile, shelf: AssetShelf) -> Link:
    if isinstance(file, CylinderLinkFile):
        shapes = tuple(_cylinder(each) for each in file.cylinders)
        return Link(file.name, tuple(shape.vertices for shape in shapes), shapes)
    if isinstance(file, PiecesLinkFile):
        pieces = tuple(_piece(np.array(corners), i) for i, corners in enumerate(file.pieces))
        return Link(file.name, pieces, tuple(ConvexShape(enclosing_hull(piece)) for piece in pieces))
    T_frame_mesh = file.transform()
    points = shelf.hull_points(file.mesh)
    points = points @ T_frame_mesh[:3, :3].T + T_frame_mesh[:3, 3]
    return Link(file.name, (points,), (ConvexShape(enclosing_hull(points)),))


def _piece(corners: Array, index: int) -> Array:
    try:
        return corners[ConvexHull(corners).vertices]
    except QhullError as error:
        raise AssetError(f"piece {index} spans no volume") from error


def _cylinder(file: CylinderFile) -> ConvexShape:
    """Return a prism around a cylinder, in the frame of its link."""
    start, end = np.array(file.start), np.array(file.end)
    axis = end - start
    hint = np.eye(3)[int(np.argmin(np.abs(axis)))]
    T_frame_cylinder = transform(frame_from_z(axis, hint), 0.5 * (start + end))
    return cylinder(file.radius, float(np.linalg.norm(axis)), CYLINDER_SIDES).placed(T_frame_cylinder)


@dataclass(frozen=True, eq=False)
class Arm:
    """One arm of a cell. Frame "<name>/i" is its frame after i joints: 0 is the base, 6 the flange."""

    name: str
    robot: Robot
    T_world_base: Transform
    """The frame before the first joint; the controller's base frame, unless the robot's file says otherwise."""
    home: Array
    """(6,) where the joints rest [rad]."""
    hand: Gripper | Pusher

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Six names, unique in the cell."""
        return tuple(f"{self.name}_{joint}" for joint in self.robot.joint_names)

    @property
    def dh(self) -> Array:
        """(6, 4) columns a, alpha, d, theta0 [m, rad]."""
        return self.robot.dh

    @property
    def position_min(self) -> Array:
        """(6,) [rad]."""
        return self.robot.position_min

    @property
    def position_max(self) -> Array:
        """(6,) [rad]."""
        return self.robot.position_max

    @property
    def velocity_max(self) -> Array:
        """(6,) [rad/s]."""
        return self.robot.velocity_max

    @property
    def acceleration_max(self) -> Array:
        """(6,) [rad/s^2]."""
        return self.robot.acceleration_max

    @property
    def torque_max(self) -> Array:
        """(6,) [Nm]."""
        return self.robot.torque_max

    @cached_property
    def masses(self) -> Array:
        """(7, 4) of the six links that move, then of the hand: mass [kg], and centre of mass [m].

        Link i is in frame i + 1, the hand in frame 6, the flange.
        """
        return np.vstack([self.robot.masses, [self.hand.mass, *self.hand.com]])

    def weighed(self, gravity: Array) -> WeighedArm:
        """Return the arm as compiled code weighs it; `gravity` is (3,) in the world [m/s^2]."""
        return WeighedArm(self.dh, self.T_world_base, self.masses, np.asarray(gravity, dtype=float))

    @property
    def spare_payload(self) -> float:
        """Largest mass that the hand may carry: the payload less what is mounted on the flange [kg]."""
        return self.robot.payload - self.hand.mass

    def link_bodies(self) -> tuple[CollisionBody, ...]:
        """Return the links "<name>_base" to "<name>_wrist_3"; link i is in frame "<name>/i"."""
        return tuple(
            CollisionBody(f"{self.name}_{link.name}", self.name, f"{self.name}/{i}", link.shapes)
            for i, link in enumerate(self.robot.links)
        )

    def hand_bodies(self, width: float | None) -> tuple[CollisionBody, ...]:
        """Return the bodies of the hand; `width` is the opening of a gripper [m], the widest when None."""
        if isinstance(self.hand, Pusher):
            return self.hand.bodies(self.name)
        return self.hand.bodies(self.name, self.hand.width_max if width is None else width)

    def document(self) -> ArmDocument:
        """Return the entry of a plan's `cell.arms`."""
        return ArmDocument(
            base=pose_row(self.T_world_base),
            dh=self.dh,
            position_min=self.position_min,
            position_max=self.position_max,
            velocity_max=self.velocity_max,
            acceleration_max=self.acceleration_max,
            torque_max=self.torque_max,
            links=tuple(LinkDocument(mass=mass, com=np.array(com)) for mass, *com in self.robot.masses.tolist()),
            payload=self.robot.payload,
        )
