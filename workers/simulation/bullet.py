"""PyBullet, and what it is given: collision shapes, and an arm with its hand as a URDF of the plan's very kinematics.

PyBullet greets on stdout when it is imported and when a server starts; here it does not.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np
from scipy.spatial import ConvexHull, HalfspaceIntersection

from planners.cell.arm import Arm
from planners.cell.hand import Gripper
from planners.geometry.pose import Array, Transform, rotation_x, rotation_z, transform
from planners.geometry.surface import Hull, hull_with_faces
from planners.scene.body import Body

__all__ = [
    "LAYER",
    "box_shape",
    "bullet",
    "convex_shape",
    "hull_shape",
    "quiet",
    "within_layer",
    "write_arm_urdf",
    "write_hull",
]

TOUCHING_PARTS = ("pad", "finger", "tip")
"""Parts of hands that touch the plate on purpose: their contact is modelled apart, see `touch`."""
LAYER = 1e-5
"""Thickness of the layer that Bullet lays around hulls, which lifts what rests on it; by itself it takes 1 mm [m]."""
_LAYER_OF_FILES = 1e-3
"""That around hulls of files, which cannot be changed [m]."""
_LEAST_INERTIA = 1e-4
"""[kg m^2]"""
_BASE_MASS = 2.0
"""Not published, and without effect: the base is fixed [kg]."""


@contextlib.contextmanager
def quiet() -> Iterator[None]:
    """Keep the greeting of PyBullet's C code to itself: stdout may carry a protocol, stderr a progress bar."""
    sys.stdout.flush()
    sys.stderr.flush()
    nowhere = os.open(os.devnull, os.O_WRONLY)
    kept = [(stream, os.dup(stream)) for stream in (1, 2)]
    for stream, _ in kept:
        os.dup2(nowhere, stream)
    os.close(nowhere)
    try:
        yield
    finally:
        # C keeps a buffer of its own.
        ctypes.CDLL(None).fflush(None)
        for stream, copy in kept:
            os.dup2(copy, stream)
            os.close(copy)


with quiet():
    import pybullet as bullet


def box_shape(size: Array, client: int, at: Array | None = None) -> int:
    """Return a box of full lengths (3,) whose centre is at (3,) `at` of the body's frame [m]."""
    return bullet.createCollisionShape(
        bullet.GEOM_BOX, halfExtents=0.5 * size, collisionFramePosition=[0.0, 0.0, 0.0] if at is None else at,
        physicsClientId=client,
    )  # fmt: skip


def hull_shape(vertices: Array, client: int) -> int:
    """Return the convex hull of vertices (n, 3) in the body's frame [m]."""
    return bullet.createCollisionShape(bullet.GEOM_MESH, vertices=vertices.tolist(), physicsClientId=client)


def convex_shape(body: Body, at: Array, client: int) -> int:
    """Return the shape of a convex body whose own frame is at (3,) `at`, its axes those of the shape."""
    if body.shape.type == "box":
        return box_shape(np.array(body.shape.size), client, at)
    (part,) = body.solid.convex_parts
    return hull_shape(part.vertices + at, client)


def within_layer(vertices: Array) -> Array:
    """Return the corners of a hull which, with the layer around it when it is read from a file, has these faces.

    Args:
        vertices: (n, 3) of the hull that is wanted [m]. Of a thin one half of the way to its middle is left.
    """
    faces = np.unique(ConvexHull(vertices).equations, axis=0)
    middle = vertices.mean(axis=0)
    depth = min(_LAYER_OF_FILES, 0.5 * float(-(faces[:, :3] @ middle + faces[:, 3]).max()))
    return HalfspaceIntersection(faces + np.array([0.0, 0.0, 0.0, depth]), middle).intersections


def write_hull(hull: Hull, T_link_frame: Transform, path: Path) -> str:
    """Write a hull, moved into a link's frame, as an OBJ file and return the file's name."""
    vertices = hull[0] @ T_link_frame[:3, :3].T + T_link_frame[:3, 3]
    # Some thousand corners an arm: formatted three at a time.
    lines = ["v {:.12g} {:.12g} {:.12g}".format(*vertex) for vertex in vertices.tolist()]
    lines += ["f {} {} {}".format(*face) for face in (hull[1] + 1).tolist()]
    path.write_text("\n".join(lines) + "\n")
    return path.name


def write_arm_urdf(arm: Arm, folder: Path) -> Path:
    """Write an arm with its hand, meshes beside it, and return the file.

    Link i of the file moves with joint i, before the fixed part `Tz(d) Tx(a) Rx(alpha)` of its table row; bodies are
    moved over accordingly.
    """
    links = [_link(arm, 0, np.eye(4), folder)]
    T_joint_frame = np.eye(4)
    for i in range(6):
        a, alpha, d, theta0 = arm.dh[i]
        # T_parent_joint: what the row before left over, then this joint's zero.
        T_parent_joint = T_joint_frame @ transform(rotation_z(theta0))
        T_joint_frame = transform(rotation_x(alpha), [a, 0.0, d])
        links.append(_joint(arm, i, T_parent_joint))
        links.append(_link(arm, i + 1, T_joint_frame, folder))
    path = folder / f"{arm.name}.urdf"
    path.write_text(f'<?xml version="1.0"?>\n<robot name={quoteattr(arm.name)}>\n' + "\n".join(links) + "\n</robot>\n")
    return path


def _link(arm: Arm, number: int, T_link_frame: Transform, folder: Path) -> str:
    link = arm.robot.links[number]
    hulls: dict[str, Hull] = {f"{link.name}_{i}": hull_with_faces(piece) for i, piece in enumerate(link.pieces)}
    masses = [(_BASE_MASS, link.points.mean(axis=0))]
    if number > 0:
        masses = [(float(arm.robot.masses[number - 1, 0]), arm.robot.masses[number - 1, 1:])]
    if number == 6:
        hulls |= {name: hull_with_faces(points) for name, points in _hand_points(arm)}
        masses.append((arm.hand.mass, arm.hand.com))
    names = [write_hull(hull, T_link_frame, folder / f"{arm.name}_{name}.obj") for name, hull in hulls.items()]
    shapes = "".join(
        f"<collision><geometry><mesh filename={quoteattr(name)}/></geometry></collision>" for name in names
    )
    return f'<link name="link_{number}">{_inertial(masses, T_link_frame)}{shapes}</link>'


def _hand_points(arm: Arm) -> Iterable[tuple[str, Array]]:
    bodies = arm.hand_bodies(None) if not isinstance(arm.hand, Gripper) else arm.hand.bodies(arm.name, 0.0)
    for body in bodies:
        part = body.name.removeprefix(f"{arm.name}_")
        if part.startswith(TOUCHING_PARTS):
            continue
        for shape in body.shapes:
            yield part, _thickened(shape.vertices, shape.radius)


def _thickened(vertices: Array, radius: float) -> Array:
    """Return corners whose hull encloses a rounded shape about as well as its mesh would."""
    if radius <= 0.0:
        return vertices
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float) / np.sqrt(3.0)
    directions = np.vstack([np.eye(3), -np.eye(3), corners])
    return (vertices[:, None] + radius * directions[None]).reshape(-1, 3)


def _joint(arm: Arm, i: int, T_parent_joint: Transform) -> str:
    robot = arm.robot
    return (
        f'<joint name="joint_{i}" type="revolute"><parent link="link_{i}"/><child link="link_{i + 1}"/>'
        f'{_origin(T_parent_joint)}<axis xyz="0 0 1"/>'
        f'<limit lower="{robot.position_min[i]:.9g}" upper="{robot.position_max[i]:.9g}" '
        f'effort="{robot.torque_max[i]:.9g}" velocity="{robot.velocity_max[i]:.9g}"/></joint>'
    )


def _inertial(masses: list[tuple[float, Array]], T_link_frame: Transform) -> str:
    total = sum(mass for mass, _ in masses)
    center = sum(mass * place for mass, place in masses) / total
    place = T_link_frame[:3, :3] @ center + T_link_frame[:3, 3]
    # Point masses about their common centre, and a ball of 5 cm for their own size: the joints are driven stiffly.
    spread = sum(mass * float((p - center) @ (p - center)) for mass, p in masses)
    inertia = max(_LEAST_INERTIA, spread + total * 0.4 * 0.05**2)
    return (
        f'<inertial><origin xyz="{_three(place)}"/><mass value="{total:.9g}"/>'
        f'<inertia ixx="{inertia:.9g}" iyy="{inertia:.9g}" izz="{inertia:.9g}" ixy="0" ixz="0" iyz="0"/></inertial>'
    )


def _origin(T: Transform) -> str:
    R = T[:3, :3]
    yaw_pitch_roll = (
        np.arctan2(R[2, 1], R[2, 2]),
        -np.arcsin(np.clip(R[2, 0], -1.0, 1.0)),
        np.arctan2(R[1, 0], R[0, 0]),
    )
    return f'<origin xyz="{_three(T[:3, 3])}" rpy="{_three(yaw_pitch_roll)}"/>'


def _three(values: Iterable[float]) -> str:
    return " ".join(f"{value:.12g}" for value in values)
