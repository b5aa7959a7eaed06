"""What a suction-tool task says, as far as the certificate compares the plan with it; and its bodies compared."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from planners.certify.common.cones import ContactLimits, StatedCup
from planners.certify.common.reserve import payload_limits
from planners.certify.common.scene import StatedBody, compare_settled, stated_obstacles, stated_shape, task_bodies
from planners.certify.evidence import CellReference, Evidence
from planners.certify.finding import Finding
from planners.certify.geometry.body_shape import BodyShape
from planners.certify.plan_view import BodyView, MalformedDocument, PlanView
from planners.certify.settings import CertifySettings
from planners.contract.task_spec import CustomTool, ObjectToMove, SuctionToolTask
from planners.geometry.pose import Array, Transform, from_pose7, inverse
from planners.plan.scenery import CellDocument, ToolDocument
from planners.plan.verdicts import Check

TOOL = "tool"
_EPS = 0.0075
"""Torsional friction of a finger where a task does not state it [m]; as in plate lifts. The planner has the same
number: the certificate has its own, so that no slip there goes unseen here."""


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

    stated: SuctionToolTask
    tool: StatedTool | None
    """None for a shipped tool, where nothing is known of these."""
    T_world_tool: Transform | None
    """None: the cell's rest, where nothing is known of it."""
    objects: tuple[StatedObject, ...]
    obstacles: tuple[StatedBody, ...]

    @classmethod
    def of(cls, task: SuctionToolTask, cell: CellDocument, reference: CellReference | None) -> ToolTask:
        """Take from a task what is compared, and what is known of the tool that it names.

        Tools that the document's cell brings are compared with the reference's where its cell is.

        Raises:
            MalformedDocument: a member of the task is missing.
        """
        known: dict[str, CustomTool | ToolDocument] = {**({} if reference is None else reference.tools)}
        known |= cell.tools or {}
        tool = known.get(task.tool) if isinstance(task.tool, str) else task.tool
        rest = None if reference is None else reference.tool_pose
        pose = rest if task.tool_pose is None else task.tool_pose
        return cls(
            stated=task,
            tool=None if tool is None else _stated_tool(tool, reference),
            T_world_tool=None if pose is None else from_pose7(pose),
            objects=tuple(_stated_object(one, f"/task/objects/{i}", reference) for i, one in enumerate(task.objects)),
            obstacles=tuple(stated_obstacles(task, reference)),
        )

    @property
    def cup(self) -> StatedCup | None:
        """The tool's cup; None where nothing is known of it."""
        return None if self.tool is None else self.tool.cup

    def limits(self, plan: PlanView) -> ContactLimits:
        """Return what contacts can bear in a plan's cell."""
        friction, most = self.stated.friction, self.stated.grip_force_limit
        mus = {"soft_finger": friction.grip, "environment": friction.environment}
        eps = friction.eps if "eps" in friction.model_fields_set else _EPS
        return ContactLimits(mus, eps, most, self.carry_limits(plan), self.cup, "dexnet", pads=most)

    def carry_limits(self, plan: PlanView) -> dict[str, float]:
        """Return the net force that each hand may exert on the tool [N]."""
        limit = self.stated.carry_force_limit
        stated = math.inf if limit is None else limit
        return {name: min(force, stated) for name, force in payload_limits(plan).items()}


def _stated_object(given: ObjectToMove, at: str, reference: CellReference | None) -> StatedObject:
    if given.com is None:
        raise MalformedDocument(f"{at}/com", "is missing")
    shape, com = stated_shape(given.shape, f"{at}/shape", reference), np.array(given.com)
    return StatedObject(
        body=StatedBody(given.name, shape, from_pose7(given.pose), given.mass, com, settled=True),
        T_world_goal=from_pose7(given.goal_pose),
        symmetry=given.goal_symmetry,
        round=given.shape.type == "cylinder",
    )


def _stated_tool(given: CustomTool | ToolDocument, reference: CellReference | None) -> StatedTool:
    if given.com is None:
        raise MalformedDocument("/task/tool/com", "is missing")
    shapes = [
        (stated_shape(part.shape, f"/task/tool/shapes/{i}/shape", reference), from_pose7(part.pose))
        for i, part in enumerate(given.shapes)
    ]
    whole = [(shape, pose) for shape, pose in shapes if shape is not None]
    cup = given.cup
    return StatedTool(
        shapes=tuple(whole) if len(whole) == len(shapes) else (),
        mass=given.mass,
        com=np.array(given.com),
        cup=StatedCup(cup.radius, cup.max_force, cup.mu, cup.kappa),
    )


def tool_bodies_check(evidence: Evidence, task: ToolTask) -> Check:
    """Check tool, objects and obstacles against the task."""
    objects, settings = [one.body for one in task.objects], evidence.settings
    roles = {TOOL: "tool"} | {body.name: "object" for body in objects}
    roles |= {body.name: "obstacle" for body in task.obstacles}
    finding, tool = task_bodies(evidence, [*objects, *task.obstacles], roles), evidence.plan.bodies[TOOL]
    if task.T_world_tool is not None:
        compare_settled(tool, task.T_world_tool, finding, settings)
    if task.tool is not None:
        _tool(tool, task.tool, finding, settings)
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
