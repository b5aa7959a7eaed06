"""What tasks of both kinds state, as far as the certificate compares plans with it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from planners.certify.body_shape import BodyShape
from planners.certify.document_view import (
    MalformedDocument,
    child,
    read_list,
    read_member,
    read_object,
    read_positive,
    read_shape,
    read_text,
    read_vector,
)
from planners.geometry.pose import Array, Transform, from_pose7


@dataclass(frozen=True, eq=False)
class StatedBody:
    """A body as the task places it."""

    name: str
    shape: BodyShape | None
    """None for a mesh that the task names by asset or upload."""
    T_world_body: Transform
    mass: float | None = None
    com: Array | None = None


def object_member(parent: Mapping[str, Any], key: str, pointer: str) -> Mapping[str, Any]:
    """Return a member that must be an object."""
    return read_object(read_member(parent, key, pointer), child(pointer, key))


def positive_member(parent: Mapping[str, Any], key: str, pointer: str) -> float:
    """Return a member that must be a number above 0."""
    return read_positive(read_member(parent, key, pointer), child(pointer, key))


def stated_pose(value: Any, pointer: str) -> Transform:
    """Read a pose of a task, whose quaternion need not be exactly unit."""
    pose = read_vector(value, pointer, 7)
    if not 0.5 < float(pose[3:] @ pose[3:]) < 2.0:
        raise MalformedDocument(pointer, "has no quaternion")
    return from_pose7(pose)


def stated_shape(body: Mapping[str, Any], pointer: str) -> BodyShape | None:
    """Read the member `shape`; None for a mesh, which tasks only name."""
    shape = object_member(body, "shape", pointer)
    return None if shape.get("type") == "mesh" else read_shape(shape, child(pointer, "shape"))


def stated_body(name: str, body: Mapping[str, Any], pointer: str) -> StatedBody:
    """Read a body that is where it stays."""
    T_world_body = stated_pose(read_member(body, "pose", pointer), child(pointer, "pose"))
    return StatedBody(name, stated_shape(body, pointer), T_world_body)


def stated_obstacles(task: Mapping[str, Any]) -> list[StatedBody]:
    """Read the obstacles of a task."""
    obstacles = []
    for index, value in enumerate(read_list(task.get("obstacles", []), "/task/obstacles")):
        at = child("/task/obstacles", index)
        obstacle = read_object(value, at)
        obstacles.append(stated_body(read_text(read_member(obstacle, "name", at), child(at, "name")), obstacle, at))
    return obstacles


def stated_start(task: Mapping[str, Any]) -> Array | None:
    """Read where the joints start: (12,); None where the task leaves it to the cell."""
    start = task.get("start_positions")
    return None if start is None else read_vector(start, "/task/start_positions", 12)
