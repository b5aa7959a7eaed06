"""What the task of a plate lift says, as far as the certificate compares the plan with it."""

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
    read_number,
    read_object,
    read_positive,
    read_shape,
    read_text,
    read_vector,
)
from planners.geometry.pose import Array, Transform, from_pose7

LIFTER_MODELS = ("paper", "cable", "dexnet")


@dataclass(frozen=True, eq=False)
class StatedBody:
    """A body as the task places it."""

    name: str
    shape: BodyShape | None
    """None for a mesh that the task names by asset or upload."""
    T_world_body: Transform
    mass: float | None = None
    com: Array | None = None


@dataclass(frozen=True, eq=False)
class StatedCup:
    """The lifter's cup."""

    position: Array
    """(2,) on the plate's top face [m]."""
    radius: float
    max_force: float
    mu: float
    kappa: float


@dataclass(frozen=True, eq=False)
class LiftTask:
    """A plate lift as the task states it."""

    bodies: tuple[StatedBody, ...]
    """Plate, support if there is one, obstacles."""
    cup: StatedCup
    lifter_model: str
    friction: Mapping[str, float]
    """Of kinds grip, push, environment; `eps` [m]."""
    normal_limit: float
    net_limit: float
    start_positions: Array | None
    goal_height: float

    @property
    def plate(self) -> StatedBody:
        """The plate."""
        return self.bodies[0]


def read_lift_task(task: Mapping[str, Any]) -> LiftTask:
    """Read the task of a document.

    Raises:
        MalformedDocument: A member is missing or of the wrong type, or the task is no plate lift.
    """
    at = "/task"
    read_text(read_member(task, "kind", at), "/task/kind", ("plate_lift",))
    friction = _object(task, "friction", at)
    limits = _object(task, "hand_force_limit", at)
    start = task.get("start_positions")
    return LiftTask(
        bodies=_bodies(task),
        cup=_cup(task),
        lifter_model=read_text(read_member(task, "lifter_model", at), "/task/lifter_model", LIFTER_MODELS),
        friction={
            key: read_number(read_member(friction, key, "/task/friction"), f"/task/friction/{key}")
            for key in ("grip", "push", "environment", "eps")
        },
        normal_limit=_positive(limits, "normal", "/task/hand_force_limit"),
        net_limit=_positive(limits, "net", "/task/hand_force_limit"),
        start_positions=None if start is None else read_vector(start, "/task/start_positions", 12),
        goal_height=_positive(_object(task, "options", at), "goal_height", "/task/options"),
    )


def _object(parent: Mapping[str, Any], key: str, pointer: str) -> Mapping[str, Any]:
    return read_object(read_member(parent, key, pointer), child(pointer, key))


def _positive(parent: Mapping[str, Any], key: str, pointer: str) -> float:
    return read_positive(read_member(parent, key, pointer), child(pointer, key))


def _cup(task: Mapping[str, Any]) -> StatedCup:
    cup, at = _object(task, "cup", "/task"), "/task/cup"
    return StatedCup(
        position=read_vector(read_member(cup, "position", at), "/task/cup/position", 2),
        radius=_positive(cup, "radius", at),
        max_force=_positive(cup, "max_force", at),
        mu=_positive(cup, "mu", at),
        kappa=read_number(read_member(cup, "kappa", at), "/task/cup/kappa"),
    )


def _bodies(task: Mapping[str, Any]) -> tuple[StatedBody, ...]:
    plate, at = _object(task, "plate", "/task"), "/task/plate"
    shape = _object(plate, "shape", at)
    read_text(read_member(shape, "type", "/task/plate/shape"), "/task/plate/shape/type", ("box", "prism"))
    bodies = [
        StatedBody(
            name="plate",
            shape=read_shape(shape, "/task/plate/shape"),
            T_world_body=_pose(read_member(task, "plate_pose", "/task"), "/task/plate_pose"),
            mass=_positive(plate, "mass", at),
            com=read_vector(read_member(plate, "com", at), "/task/plate/com", 3),
        )
    ]
    if task.get("support") is not None:
        bodies.append(_placed("support", _object(task, "support", "/task"), "/task/support"))
    for index, value in enumerate(read_list(task.get("obstacles", []), "/task/obstacles")):
        at = child("/task/obstacles", index)
        obstacle = read_object(value, at)
        name = read_text(read_member(obstacle, "name", at), child(at, "name"))
        bodies.append(_placed(name, obstacle, at))
    return tuple(bodies)


def _placed(name: str, body: Mapping[str, Any], pointer: str) -> StatedBody:
    shape = _object(body, "shape", pointer)
    return StatedBody(
        name=name,
        shape=None if shape.get("type") == "mesh" else read_shape(shape, child(pointer, "shape")),
        T_world_body=_pose(read_member(body, "pose", pointer), child(pointer, "pose")),
    )


def _pose(value: Any, pointer: str) -> Transform:
    """Read a pose of a task, whose quaternion need not be exactly unit."""
    pose = read_vector(value, pointer, 7)
    if not 0.5 < float(pose[3:] @ pose[3:]) < 2.0:
        raise MalformedDocument(pointer, "has no quaternion")
    return from_pose7(pose)
