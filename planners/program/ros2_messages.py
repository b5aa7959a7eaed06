"""Messages of ROS 2, made by their names and the names of their fields, and written as bags have them.

`rosbags` knows the messages that every ROS 2 has. Those of MoveIt and of the controllers are stated here as their
packages define them: names, order and types of fields are what makes a message the same one elsewhere.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import cache
from typing import Any

import numpy as np
from rosbags.interfaces import (
    Nodetype,
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from planners.geometry.pose import Array, Transform, to_pose7

NANOSECONDS = 1_000_000_000
ADD, REMOVE, MOVE = 0, 1, 3
"""What is done with a `moveit_msgs/CollisionObject`."""
BOX, CYLINDER = 1, 3
"""Types of a `shape_msgs/SolidPrimitive`."""
CUBE_MARKER, CYLINDER_MARKER, TRIANGLES_MARKER = 1, 3, 11
"""Types of a `visualization_msgs/Marker`."""
_NEVER = QosTime(0, 0)
QOS = Qos(
    QosHistory.KEEP_LAST,
    10,
    QosReliability.RELIABLE,
    QosDurability.VOLATILE,
    _NEVER,
    _NEVER,
    QosLiveliness.SYSTEM_DEFAULT,
    _NEVER,
    avoid_ros_namespace_conventions=False,
)
LATCHED_QOS = QOS._replace(depth=1, durability=QosDurability.TRANSIENT_LOCAL)
"""Of what is said once, for whoever comes later too."""
_DEFINED = {
    "control_msgs/msg/GripperCommand": "float64 position\nfloat64 max_effort",
    "object_recognition_msgs/msg/ObjectType": "string key\nstring db",
    "octomap_msgs/msg/Octomap": ("std_msgs/Header header\nbool binary\nstring id\nfloat64 resolution\nint8[] data"),
    "octomap_msgs/msg/OctomapWithPose": (
        "std_msgs/Header header\ngeometry_msgs/Pose origin\noctomap_msgs/Octomap octomap"
    ),
    "moveit_msgs/msg/RobotTrajectory": (
        "trajectory_msgs/JointTrajectory joint_trajectory\n"
        "trajectory_msgs/MultiDOFJointTrajectory multi_dof_joint_trajectory"
    ),
    "moveit_msgs/msg/CollisionObject": (
        "std_msgs/Header header\ngeometry_msgs/Pose pose\nstring id\nobject_recognition_msgs/ObjectType type\n"
        "shape_msgs/SolidPrimitive[] primitives\ngeometry_msgs/Pose[] primitive_poses\n"
        "shape_msgs/Mesh[] meshes\ngeometry_msgs/Pose[] mesh_poses\n"
        "shape_msgs/Plane[] planes\ngeometry_msgs/Pose[] plane_poses\n"
        "string[] subframe_names\ngeometry_msgs/Pose[] subframe_poses\n"
        "byte ADD=0\nbyte REMOVE=1\nbyte APPEND=2\nbyte MOVE=3\nbyte operation"
    ),
    "moveit_msgs/msg/AttachedCollisionObject": (
        "string link_name\nmoveit_msgs/CollisionObject object\nstring[] touch_links\n"
        "trajectory_msgs/JointTrajectory detach_posture\nfloat64 weight"
    ),
    "moveit_msgs/msg/RobotState": (
        "sensor_msgs/JointState joint_state\nsensor_msgs/MultiDOFJointState multi_dof_joint_state\n"
        "moveit_msgs/AttachedCollisionObject[] attached_collision_objects\nbool is_diff"
    ),
    "moveit_msgs/msg/AllowedCollisionEntry": "bool[] enabled",
    "moveit_msgs/msg/AllowedCollisionMatrix": (
        "string[] entry_names\nmoveit_msgs/AllowedCollisionEntry[] entry_values\n"
        "string[] default_entry_names\nbool[] default_entry_values"
    ),
    "moveit_msgs/msg/LinkPadding": "string link_name\nfloat64 padding",
    "moveit_msgs/msg/LinkScale": "string link_name\nfloat64 scale",
    "moveit_msgs/msg/ObjectColor": "string id\nstd_msgs/ColorRGBA color",
    "moveit_msgs/msg/PlanningSceneWorld": (
        "moveit_msgs/CollisionObject[] collision_objects\noctomap_msgs/OctomapWithPose octomap"
    ),
    "moveit_msgs/msg/PlanningScene": (
        "string name\nmoveit_msgs/RobotState robot_state\nstring robot_model_name\n"
        "geometry_msgs/TransformStamped[] fixed_frame_transforms\n"
        "moveit_msgs/AllowedCollisionMatrix allowed_collision_matrix\nmoveit_msgs/LinkPadding[] link_padding\n"
        "moveit_msgs/LinkScale[] link_scale\nmoveit_msgs/ObjectColor[] object_colors\n"
        "moveit_msgs/PlanningSceneWorld world\nbool is_diff"
    ),
}


@cache
def message_types() -> Typestore:
    """Return all types there are, as ROS 2 Humble and later have them."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    for name, fields in _DEFINED.items():
        store.register(get_types_from_msg(fields, name))
    return store


def message(name: str, /, **fields: Any) -> Any:
    """Return a message; fields that are not given are zero or empty, as in ROS.

    Args:
        name: as `std_msgs/String`.
        fields: by their names; sequences of numbers may be any that numpy makes an array of.
    """
    package, _, kind = name.partition("/")
    full = f"{package}/msg/{kind}"
    store = message_types()
    values = {field: _value(kind, fields.pop(field, None)) for field, kind in store.fielddefs[full][1]}
    assert not fields, f"{name} has no {', '.join(fields)}"
    return store.types[full](**values)


def as_json(value: Any) -> Any:
    """Return a message as JSON data: members have the names of its fields."""
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, list):
        return [as_json(each) for each in value]
    if hasattr(value, "__msgtype__"):
        fields = message_types().fielddefs[value.__msgtype__][1]
        return {field: as_json(getattr(value, field)) for field, _ in fields}
    return value


def _value(kind: Any, given: Any) -> Any:
    """Return what a field of a kind has: what was given, or what it has of itself."""
    node, about = kind
    if node is Nodetype.BASE:
        return (
            {"string": "", "bool": False, "float32": 0.0, "float64": 0.0}.get(about[0], 0) if given is None else given
        )
    if node is Nodetype.NAME:
        return message(about.replace("/msg/", "/")) if given is None else given
    (inner, inside), size = about
    if inner is Nodetype.BASE and inside[0] != "string":
        dtype = np.dtype({"byte": "uint8", "octet": "uint8", "char": "uint8"}.get(inside[0], inside[0]))
        return np.zeros(size if node is Nodetype.ARRAY else 0, dtype) if given is None else np.asarray(given, dtype)
    return [] if given is None else list(given)


def nanoseconds(time: float) -> int:
    """Return a time [s] in whole nanoseconds."""
    return round(time * NANOSECONDS)


def stamp(time: int) -> Any:
    """Return nanoseconds as a time."""
    return message("builtin_interfaces/Time", sec=time // NANOSECONDS, nanosec=time % NANOSECONDS)


def duration(time: int) -> Any:
    """Return nanoseconds as a duration."""
    return message("builtin_interfaces/Duration", sec=time // NANOSECONDS, nanosec=time % NANOSECONDS)


def header(time: int, frame: str = "") -> Any:
    """Return a header; `time` in nanoseconds."""
    return message("std_msgs/Header", stamp=stamp(time), frame_id=frame)


def point(position: Array) -> Any:
    """Return a point (3,) [m]."""
    x, y, z = map(float, position)
    return message("geometry_msgs/Point", x=x, y=y, z=z)


def vector(values: Iterable[float]) -> Any:
    """Return a vector (3,)."""
    x, y, z = map(float, values)
    return message("geometry_msgs/Vector3", x=x, y=y, z=z)


def pose(T: Transform) -> Any:
    """Return a pose (4, 4)."""
    row = to_pose7(T)
    return message("geometry_msgs/Pose", position=point(np.array(row[:3])), orientation=_quaternion(row[3:]))


def pose_of_row(row: Array) -> Any:
    """Return a pose `[x, y, z, w, x, y, z]`, digit by digit."""
    return message("geometry_msgs/Pose", position=point(row[:3]), orientation=_quaternion(row[3:]))


def transform_of_row(time: int, child: str, row: Array, parent: str) -> Any:
    """Return where a frame is at a time [ns], from its pose `[x, y, z, w, x, y, z]` in another frame."""
    placed = message("geometry_msgs/Transform", translation=vector(row[:3]), rotation=_quaternion(row[3:]))
    return message(
        "geometry_msgs/TransformStamped", header=header(time, parent), child_frame_id=child, transform=placed
    )


def _quaternion(wxyz: Iterable[float]) -> Any:
    w, x, y, z = map(float, wxyz)
    return message("geometry_msgs/Quaternion", x=x, y=y, z=z, w=w)


def joint_trajectory(
    names: Iterable[str], times: Iterable[int], positions: Array, velocities: Array, accelerations: Array
) -> Any:
    """Return a trajectory whose stamp is the first of its times.

    Args:
        names: of n joints.
        times: of m samples on the plan's clock [ns].
        positions: (m, n) [rad].
        velocities: (m, n) [rad/s].
        accelerations: (m, n) [rad/s^2].
    """
    times = list(times)
    points = [
        message(
            "trajectory_msgs/JointTrajectoryPoint",
            positions=np.array(q),
            velocities=np.array(v),
            accelerations=np.array(a),
            time_from_start=duration(time - times[0]),
        )
        for time, q, v, a in zip(times, positions, velocities, accelerations, strict=True)
    ]
    return message("trajectory_msgs/JointTrajectory", header=header(times[0]), joint_names=names, points=points)


def joint_state(time: int, positions: Mapping[str, float], velocities: Array | None = None) -> Any:
    """Return where joints are at a time [ns]: by name [rad, m], and how fast they move, in the same order."""
    still = np.empty(0) if velocities is None else velocities
    return message(
        "sensor_msgs/JointState",
        header=header(time),
        name=list(positions),
        position=list(positions.values()),
        velocity=still,
    )
