"""What a suction-tool task says, as far as the certificate compares the plan with it; and its bodies compared."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from planners.certify.common.cones import ContactLimits, StatedCup
from planners.certify.common.reserve import payload_limits
from planners.certify.common.scene import (
    CellReference,
    StatedBody,
    compare_body,
    compare_settled,
    stated_obstacles,
    stated_shape,
    stated_start,
)
from planners.certify.finding import Finding
from planners.certify.geometry.body_shape import BodyShape
from planners.certify.geometry.cover import beyond_parts
from planners.certify.plan_view import BodyView, MalformedDocument, PlanView
from planners.certify.settings import CertifySettings
from planners.contract.task_spec import CustomTool, ObjectToMove, SuctionToolTask
from planners.geometry.pose import Array, Transform, from_pose7, inverse
from planners.plan.verdicts import Check

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
        tool=_stated_tool(known.get(task.tool) if isinstance(task.tool, str) else task.tool),
        T_world_tool=rest if task.tool_pose is None else from_pose7(task.tool_pose),
        objects=tuple(_stated_object(given, f"/task/objects/{i}") for i, given in enumerate(task.objects)),
        obstacles=tuple(stated_obstacles(task)),
        grip_friction=task.friction.grip,
        environment_friction=task.friction.environment,
        grip_force_limit=task.grip_force_limit,
        carry_force_limit=task.carry_force_limit,
        start_positions=stated_start(task),
    )


def _stated_object(given: ObjectToMove, at: str) -> StatedObject:
    if given.com is None:
        raise MalformedDocument(f"{at}/com", "is missing")
    shape, com = stated_shape(given.shape, f"{at}/shape"), np.array(given.com)
    return StatedObject(
        body=StatedBody(given.name, shape, from_pose7(given.pose), given.mass, com),
        T_world_goal=from_pose7(given.goal_pose),
        symmetry=given.goal_symmetry,
        round=given.shape.type == "cylinder",
    )


def _stated_tool(given: CustomTool | None) -> StatedTool | None:
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


def tool_bodies_check(plan: PlanView, task: ToolTask, settings: CertifySettings) -> Check:
    """Check tool, objects and obstacles against the task, and that meshes are inside their convex parts."""
    finding = Finding("task_bodies", "m, kg")
    stated = [(one.body, True) for one in task.objects] + [(body, False) for body in task.obstacles]
    for body, settled in stated:
        if body.name not in plan.bodies:
            finding.require(False, f"body {body.name}", "is in the task, not in the document")
        else:
            compare_body(plan.bodies[body.name], body, finding, settings, settled=settled)
    tool = plan.bodies[TOOL]
    if task.T_world_tool is not None:
        compare_settled(tool, task.T_world_tool, finding, settings)
    if task.tool is not None:
        _tool(tool, task.tool, finding, settings)
    roles = {TOOL: "tool"} | {one.body.name: "object" for one in task.objects}
    roles |= {body.name: "obstacle" for body in task.obstacles}
    for name, body in plan.bodies.items():
        # Whatever the task does not state belongs to the cell.
        known = body.role == roles[name] if name in roles else body.role in ("table", "frame")
        finding.require(known, f"body {name}: role", f"{body.role!r} is not what the task makes of it")
        fixed = roles.get(name) not in ("tool", "object")
        finding.require(body.static == fixed, f"body {name}: static", f"must be {fixed}")
        _covered(body, finding, settings)
    return finding.check()


def _tool(body: BodyView, stated: StatedTool, finding: Finding, settings: CertifySettings) -> None:
    finding.note(settings.join - float(np.abs(body.com - stated.com).max()), "body tool: com")
    finding.note(settings.join - abs((body.mass or 0.0) - stated.mass), "body tool: mass")
    if not stated.shapes:
        return
    placed = [(shape, inverse(T)) for shape, T in stated.shapes]
    for vertex in body.shape.vertices:
        off = min(abs(shape.surface_distance(T[:3, :3] @ vertex + T[:3, 3])[0]) for shape, T in placed)
        finding.note(settings.tool_shape - off, "body tool: shape")
    for shape, T in stated.shapes:
        for vertex in shape.vertices @ T[:3, :3].T + T[:3, 3]:
            finding.note(settings.tool_shape - abs(body.shape.surface_distance(vertex)[0]), "body tool: shape")


def _covered(body: BodyView, finding: Finding, settings: CertifySettings) -> None:
    """The convex parts of a mesh, by which collisions are judged, contain its surface."""
    if body.shape.surface is None:
        return
    height, point = beyond_parts(body.shape, settings.contact_distance)
    finding.note(
        settings.contact_distance - height, f"body {body.name}: convex parts, at {np.round(point, 4).tolist()}"
    )
