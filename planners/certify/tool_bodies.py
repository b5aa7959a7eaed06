"""The bodies of a suction-tool plan are those of its task, and its tool is the one that the task names."""

from __future__ import annotations

import numpy as np

from planners.certify.finding import Finding
from planners.certify.part_cover import beyond_parts
from planners.certify.plan_view import BodyView, PlanView
from planners.certify.scene_facts import compare_body, compare_settled
from planners.certify.settings import CertifySettings
from planners.certify.tool_task import TOOL, StatedTool, ToolTask
from planners.geometry.pose import inverse
from planners.plan.verdicts import Check


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
