"""What a suction-tool task says, as far as the certificate compares the plan with it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from planners.certify.body_shape import BodyShape
from planners.certify.cones import ContactLimits, StatedCup
from planners.certify.document_view import (
    PlanView,
    child,
    read_list,
    read_member,
    read_number,
    read_object,
    read_pose,
    read_shape,
    read_text,
    read_vector,
)
from planners.certify.payload import payload_limits
from planners.certify.scene_facts import CellReference
from planners.certify.stated import (
    StatedBody,
    object_member,
    positive_member,
    stated_obstacles,
    stated_pose,
    stated_shape,
    stated_start,
)
from planners.geometry.pose import Array, Transform

TOOL = "tool"
SYMMETRIES = ("none", "axis", "shape")
_EPS = 0.0075
"""Torsional friction of a finger, which no suction-tool task states [m]; as in plate lifts."""


@dataclass(frozen=True, eq=False)
class StatedTool:
    """The tool: as the task describes it, or as a shipped one is known."""

    shapes: tuple[tuple[BodyShape, Transform], ...]
    """Each in its frame, and its pose in the tool's frame; none where a mesh is only named."""
    mass: float
    com: Array
    cup: StatedCup


@dataclass(frozen=True, eq=False)
class StatedObject:
    """An object and its goal."""

    body: StatedBody
    T_world_goal: Transform
    symmetry: str
    round: bool
    """Whether its shape is a cylinder."""


@dataclass(frozen=True, eq=False)
class ToolTask:
    """A suction-tool task as it is stated."""

    tool: StatedTool | None
    """None for a shipped tool, where nothing is known of these."""
    T_world_tool: Transform | None
    """None: the cell's rest, where nothing is known of it."""
    objects: tuple[StatedObject, ...]
    obstacles: tuple[StatedBody, ...]
    grip_friction: float
    environment_friction: float
    grip_force_limit: float
    carry_force_limit: float | None
    """Of one hand, if the task says any."""
    start_positions: Array | None

    def limits(self, plan: PlanView) -> ContactLimits:
        """Return what contacts can bear in a plan's cell."""
        friction = {"soft_finger": self.grip_friction, "environment": self.environment_friction}
        cup = None if self.tool is None else self.tool.cup
        most = self.grip_force_limit
        return ContactLimits(friction, _EPS, most, self.carry_limits(plan), cup, "dexnet", pads=most)

    def carry_limits(self, plan: PlanView) -> dict[str, float]:
        """Return the net force that each hand may exert on the tool [N]."""
        stated = math.inf if self.carry_force_limit is None else self.carry_force_limit
        return {name: min(force, stated) for name, force in payload_limits(plan).items()}


def read_tool_task(task: Mapping[str, Any], reference: CellReference | None) -> ToolTask:
    """Read the task of a document, and what is known of the tool that it names.

    Raises:
        MalformedDocument: A member is missing or of the wrong type.
    """
    at = "/task"
    friction = object_member(task, "friction", at)
    objects = read_list(read_member(task, "objects", at), "/task/objects")
    pose = read_member(task, "tool_pose", at)
    rest = None if reference is None or reference.tool_pose is None else read_pose(list(reference.tool_pose), "/cell")
    return ToolTask(
        tool=_tool(read_member(task, "tool", at), reference),
        T_world_tool=rest if pose is None else stated_pose(pose, "/task/tool_pose"),
        objects=tuple(_object(value, child("/task/objects", i)) for i, value in enumerate(objects)),
        obstacles=tuple(stated_obstacles(task)),
        grip_friction=read_number(read_member(friction, "grip", "/task/friction"), "/task/friction/grip"),
        environment_friction=read_number(
            read_member(friction, "environment", "/task/friction"), "/task/friction/environment"
        ),
        grip_force_limit=positive_member(task, "grip_force_limit", at),
        carry_force_limit=(
            None if task.get("carry_force_limit") is None else positive_member(task, "carry_force_limit", at)
        ),
        start_positions=stated_start(task),
    )


def _object(value: Any, at: str) -> StatedObject:
    given = read_object(value, at)
    shape = object_member(given, "shape", at)
    body = StatedBody(
        name=read_text(read_member(given, "name", at), child(at, "name")),
        shape=stated_shape(given, at),
        T_world_body=stated_pose(read_member(given, "pose", at), child(at, "pose")),
        mass=positive_member(given, "mass", at),
        com=read_vector(read_member(given, "com", at), child(at, "com"), 3),
    )
    return StatedObject(
        body=body,
        T_world_goal=stated_pose(read_member(given, "goal_pose", at), child(at, "goal_pose")),
        symmetry=read_text(read_member(given, "goal_symmetry", at), child(at, "goal_symmetry"), SYMMETRIES),
        round=shape.get("type") == "cylinder",
    )


def _tool(value: Any, reference: CellReference | None) -> StatedTool | None:
    at = "/task/tool"
    if isinstance(value, str):
        known = None if reference is None else reference.tools.get(value)
        if known is None:
            return None
        value = known
    given = read_object(value, at)
    cup = object_member(given, "cup", at)
    shapes = []
    for i, part in enumerate(read_list(read_member(given, "shapes", at), child(at, "shapes"))):
        where = child(child(at, "shapes"), i)
        shape = object_member(read_object(part, where), "shape", where)
        if shape.get("type") == "mesh" and "vertices" not in shape:
            shapes = []
            break
        pose = stated_pose(read_member(part, "pose", where), child(where, "pose"))
        shapes.append((read_shape(shape, child(where, "shape")), pose))
    return StatedTool(
        shapes=tuple(shapes),
        mass=positive_member(given, "mass", at),
        com=np.array(read_vector(read_member(given, "com", at), child(at, "com"), 3)),
        cup=StatedCup(
            radius=positive_member(cup, "radius", child(at, "cup")),
            max_force=positive_member(cup, "max_force", child(at, "cup")),
            mu=positive_member(cup, "mu", child(at, "cup")),
            kappa=read_number(read_member(cup, "kappa", child(at, "cup")), child(at, "cup/kappa")),
        ),
    )
