"""One arm as it comes from its maker: kinematic table, joint limits and links, wherever it is mounted."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from planners.errors import AssetError
from planners.geometry.convex import ConvexShape
from planners.geometry.pose import Array
from planners.kinematics.inverse import is_ur_type
from planners.scene.asset_files import AssetShelf, LinkFile, LinkName, RobotFile, fingerprint, read_robot_file
from planners.scene.meshes import Hull, enclosing_hull, hull_points, hull_with_faces, mesh_path


@dataclass(frozen=True, eq=False)
class Link:
    """A rigid link, in the frame after as many joints as there are before it."""

    name: LinkName
    points: Array
    """(n, 3) corners of the convex hull of the mesh [m]."""
    shape: ConvexShape
    """Few vertices around `points`."""


@dataclass(frozen=True, eq=False)
class Robot:
    """A six-joint arm of the UR family. Arrays of joint limits are (6,), in SI units."""

    name: str
    joint_names: tuple[str, ...]
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
    """[m]"""
    fingerprint: str
    """Hash of the files it was loaded from, meshes included."""

    def link_hulls(self) -> dict[LinkName, Hull]:
        """Return the unsimplified convex hull of each link, in the frame that the link moves with."""
        return {link.name: hull_with_faces(link.points) for link in self.links}


def load_robot(name: str, shelf: AssetShelf, where: str) -> Robot:
    """Load robots/<name>.yaml with its meshes.

    Args:
        name: name of the robot.
        shelf: where to look.
        where: the field that names the robot, for messages.

    Raises:
        AssetError: A file is missing or wrong, or its table is not one of the UR family.
    """
    path = shelf.find("robots", name, where)
    file = read_robot_file(path)
    joints = file.joints
    dh = np.array([[j.a, np.radians(j.alpha_deg), j.d, np.radians(j.theta0_deg)] for j in joints])
    if not is_ur_type(dh):
        raise AssetError(
            f"{path}: joints: alpha_deg must be 90, 0, 0, 90, -90, 0 and a must be zero except for joints 2 and 3: "
            "the closed-form inverse kinematics is that of the UR family"
        )
    position = np.radians([j.position_deg for j in joints])
    link_files = _link_files(file, shelf, path)
    return Robot(
        name=file.name,
        joint_names=tuple(j.name for j in joints),
        dh=dh,
        position_min=np.ascontiguousarray(position[:, 0]),
        position_max=np.ascontiguousarray(position[:, 1]),
        velocity_max=np.radians([j.velocity_deg for j in joints]),
        acceleration_max=np.array([j.acceleration for j in joints]),
        torque_max=np.array([j.torque for j in joints]),
        links=tuple(_link(link, f"{path}: links.{i}.mesh") for i, link in enumerate(link_files)),
        masses=np.array([[link.mass, *link.com] for link in file.masses]),
        payload=file.payload,
        reach=file.reach,
        fingerprint=fingerprint(_contents(file, link_files)),
    )


def _link_files(file: RobotFile, shelf: AssetShelf, path: Path) -> tuple[LinkFile, ...]:
    if file.links is not None:
        return file.links
    stand_in = read_robot_file(shelf.find("robots", str(file.links_of), f"{path}: links_of"))
    if stand_in.links is None:
        raise AssetError(f"{path}: links_of: {file.links_of!r} has no links of its own")
    return stand_in.links


def _contents(file: RobotFile, links: tuple[LinkFile, ...]) -> Iterator[bytes]:
    yield file.model_dump_json().encode()
    for link in links:
        yield link.model_dump_json().encode()
        yield mesh_path(link.mesh).read_bytes()


def _link(file: LinkFile, where: str) -> Link:
    T_frame_mesh = file.transform()
    try:
        points = hull_points(file.mesh)
    except AssetError as error:
        raise AssetError(f"{where}: {error}") from error
    points = points @ T_frame_mesh[:3, :3].T + T_frame_mesh[:3, 3]
    return Link(file.name, points, ConvexShape(enclosing_hull(points)))
