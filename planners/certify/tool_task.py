"""What a suction-tool task says, as far as the certificate compares the plan with it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from planners.certify.body_shape import BodyShape
from planners.certify.cones import ContactLimits, StatedCup
from planners.certify.payload import payload_limits
from planners.certify.plan_view import MalformedDocument, PlanView
from planners.certify.scene_facts import CellReference
from planners.certify.stated import StatedBody, stated_obstacles, stated_shape, stated_start
from planners.contract.task_spec import CustomTool, ObjectToMove, SuctionToolTask
from planners.geometry.pose import Array, Transform, from_pose7

TOOL = "tool"
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


def read_tool_task(task: SuctionToolTask, reference: CellReference | None) -> ToolTask:
    """Take from a task what is compared, and what is known of the tool that it names."""
    rest = None if reference is None or reference.tool_pose is None else from_pose7(reference.tool_pose)
    known = {} if reference is None else reference.tools
    return ToolTask(
        tool=_tool(known.get(task.tool) if isinstance(task.tool, str) else task.tool),
        T_world_tool=rest if task.tool_pose is None else from_pose7(task.tool_pose),
        objects=tuple(_object(given, f"/task/objects/{i}") for i, given in enumerate(task.objects)),
        obstacles=tuple(stated_obstacles(task)),
        grip_friction=task.friction.grip,
        environment_friction=task.friction.environment,
        grip_force_limit=task.grip_force_limit,
        carry_force_limit=task.carry_force_limit,
        start_positions=stated_start(task),
    )


def _object(given: ObjectToMove, at: str) -> StatedObject:
    if given.com is None:
        raise MalformedDocument(f"{at}/com", "is missing")
    shape, com = stated_shape(given.shape, f"{at}/shape"), np.array(given.com)
    return StatedObject(
        body=StatedBody(given.name, shape, from_pose7(given.pose), given.mass, com),
        T_world_goal=from_pose7(given.goal_pose),
        symmetry=given.goal_symmetry,
        round=given.shape.type == "cylinder",
    )


def _tool(given: CustomTool | None) -> StatedTool | None:
    if given is None:
        return None
    if given.com is None:
        raise MalformedDocument("/task/tool/com", "is missing")
    shapes = [
        (stated_shape(part.shape, f"/task/tool/shapes/{i}/shape"), from_pose7(part.pose))
        for i, part in enumerate(given.shapes)
    ]
    whole = [(shape, pose) for shape, pose in shapes if shape is not None]
    cup = given.cup
    return StatedTool(
        shapes=tuple(whole) if len(whole) == len(shapes) else (),
        mass=given.mass,
        com=np.array(given.com),
        cup=StatedCup(radius=cup.radius, max_force=cup.max_force, mu=cup.mu, kappa=cup.kappa),
    )
