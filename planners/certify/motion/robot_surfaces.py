"""The robots' surfaces: convex hulls of the makers' meshes, unreduced, from the `airo-models` package.

Read here a second time and in another way than the cell does, by pinocchio on the URDF, so that a mesh the planners
have put in the wrong place is found.
"""

# pinocchio has no type stubs for what its compiled part exports.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import airo_models
import numpy as np
import pinocchio as pin
import trimesh

from planners.certify.geometry.body_shape import ConvexPart, box, convex_part, cylinder
from planners.certify.motion.kinematics import ArmKinematics
from planners.errors import AssetError
from planners.geometry.pose import Array, inverse, rotation_x, transform

LINKS = ("base", "shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3")
_UR3E_DH = np.array(
    [
        [0.0, math.pi / 2, 0.15185, 0.0],
        [-0.24355, 0.0, 0.0, 0.0],
        [-0.2132, 0.0, 0.0, 0.0],
        [0.0, math.pi / 2, 0.13105, 0.0],
        [0.0, -math.pi / 2, 0.08535, 0.0],
        [0.0, 0.0, 0.0921, 0.0],
    ]
)
SENSOR_LENGTH = 0.0484
"""Coupling and FT300, from the flange to the base of gripper or stick [m]; facts of the cell."""
_SENSOR_RADIUS = 0.0375
_FINGER_PARTS = ("outer_knuckle", "outer_finger", "inner_knuckle", "inner_finger")
_MILLIMETRE = 0.001
# The finger's four-bar linkage in the gripper's base frame, finger 1 (at +y); of the gripper's URDF [m].
_KNUCKLE_PIVOT = np.array([0.0, 0.0306011, 0.054904])
_INNER_PIVOT = np.array([0.0, 0.0127, 0.06142])
_OUTER_FINGER = np.array([0.0, 0.0315, -0.0041])
_INNER_FINGER = np.add(_OUTER_FINGER, [0.0, 0.0061, 0.0471])
_PAD = np.array([0.0, -0.0220203446692936, 0.03242])
PAD_SIZE = np.array([0.022, 0.00635, 0.0375])
"""Width of its inner face, thickness, length of the face [m]."""
LARGEST_WIDTH = 2 * float(_KNUCKLE_PIVOT[1] + _INNER_FINGER[1] + _PAD[1] - PAD_SIZE[1] / 2)
"""Inner distance of the pads at the open stop [m]."""
_LARGEST_TURN = 0.85
"""Finger joint angle beyond which the pads would cross [rad]."""


@dataclass(frozen=True, eq=False)
class RobotSurfaces:
    """Hulls of one arm's links, of the sensor on its flange and of the gripper's parts."""

    links: tuple[ConvexPart, ...]
    """Seven hulls; number i in the frame after i joints (0 = base)."""
    sensor: ConvexPart
    """In the flange frame."""
    gripper_base: ConvexPart
    """In the flange frame."""
    finger_parts: Mapping[str, ConvexPart]
    """Parts of finger 1 in their own frames, see `finger_poses`; finger 0 is finger 1 turned half about z."""


def load_surfaces(folder: Path | None = None) -> RobotSurfaces:
    """Read the meshes of UR3e and 2F-85.

    Args:
        folder: The root of the `airo-models` package; None takes the installed one.

    Raises:
        AssetError: A mesh is missing or has no volume.
    """
    root = folder or Path(airo_models.__file__).parent
    gripper = root / "grippers" / "robotiq_2f_85" / "meshes" / "collision"
    base = np.add(_vertices(gripper / "robotiq_arg2f_base_link.obj"), [0.0, 0.0, SENSOR_LENGTH])
    files = {name: f"robotiq_arg2f_85_{name}.obj" for name in _FINGER_PARTS}
    parts = {name: _hull(_MILLIMETRE * _vertices(gripper / file), file) for name, file in files.items()}
    parts["pad"] = box(PAD_SIZE).parts[0]
    sensor = cylinder(_SENSOR_RADIUS, SENSOR_LENGTH).parts[0]
    return RobotSurfaces(
        links=_link_hulls(root / "arms" / "ur3e"),
        sensor=convex_part(np.add(sensor.vertices, [0.0, 0.0, SENSOR_LENGTH / 2])),
        gripper_base=_hull(base, "robotiq_arg2f_base_link.obj"),
        finger_parts=parts,
    )


def _link_hulls(folder: Path) -> tuple[ConvexPart, ...]:
    """Take the meshes from where the URDF places them at zero to the frames of the contract."""
    # The URDF uses the prefix `drake:` undeclared, and shows the base with its cable, 0.34 m of it.
    try:
        text = (folder / "ur3e.urdf").read_text()
    except OSError as error:
        raise AssetError(f"ur3e.urdf of airo-models cannot be read: {error.strerror}") from error
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
    frames = ArmKinematics(_UR3E_DH, np.eye(4)).frames(np.zeros((1, 6)))[0]
    hulls = []
    for index, link in enumerate(LINKS):
        mesh = link.replace("_", "")
        shape = geometry.getGeometryId(("base_link_inertia" if index == 0 else f"{link}_link") + "_0")
        T_link_mesh = inverse(frames[index]) @ T_base_root @ geometry_data.oMg[shape].homogeneous
        vertices = _vertices(folder / "collision" / f"{mesh}.obj") @ T_link_mesh[:3, :3].T + T_link_mesh[:3, 3]
        hulls.append(_hull(vertices, mesh))
    return tuple(hulls)


def _vertices(path: Path) -> Array:
    """Return the vertices (n, 3) of a mesh in their order."""
    try:
        return np.asarray(trimesh.load_mesh(path, process=False, maintain_order=True, skip_materials=True).vertices)
    except (OSError, ValueError) as error:
        raise AssetError(f"{path.name} of airo-models cannot be read: {error}") from error


def _hull(vertices: Array, name: str) -> ConvexPart:
    try:
        return convex_part(vertices)
    except ValueError as error:
        raise AssetError(f"mesh {name} of airo-models: {error}") from error


def finger_angles(widths: Array) -> Array:
    """Return the finger joint's angle for each inner distance of the pads: [m] → [rad].

    gap = 2 (c + a cos q - b sin q), with a, b from the linkage and c from the pad; solved for q in closed form.
    """
    _, a, b = _INNER_FINGER
    c = _KNUCKLE_PIVOT[1] + _PAD[1] - PAD_SIZE[1] / 2
    cosine = np.clip((widths / 2 - c) / math.hypot(a, b), -1.0, 1.0)
    return np.clip(np.arccos(cosine) - math.atan2(b, a), 0.0, _LARGEST_TURN)


def finger_poses(part: str, finger: int, widths: Array) -> Array:
    """Return the poses of a finger's part in the flange frame at each opening: (n,) [m] → (n, 4, 4).

    The knuckles turn with the finger joint; finger and pad keep their orientation and travel on a circle.
    """
    poses = np.empty((len(widths), 4, 4))
    turned = np.diag([-1.0, -1.0, 1.0]) if finger == 0 else np.eye(3)
    for index, angle in enumerate(finger_angles(widths)):
        turn = rotation_x(float(angle))
        if part == "inner_knuckle":
            rotation, position = turn, _INNER_PIVOT
        elif part == "outer_knuckle":
            rotation, position = turn, _KNUCKLE_PIVOT
        elif part == "outer_finger":
            rotation, position = turn, _KNUCKLE_PIVOT + turn @ _OUTER_FINGER
        else:
            rotation, position = np.eye(3), _KNUCKLE_PIVOT + turn @ _INNER_FINGER
            if part == "pad":
                position = position + _PAD
        poses[index] = transform(turned @ rotation, turned @ position + [0.0, 0.0, SENSOR_LENGTH])
    return poses


def pad_height(widths: Array) -> Array:
    """Return the height of the pads' centres above the flange at each opening [m]."""
    return finger_poses("pad", 1, widths)[:, 2, 3]
