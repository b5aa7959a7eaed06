"""The bodies of a plate lift are those of its task."""

from __future__ import annotations

import numpy as np

from planners.certify.finding import Finding
from planners.certify.lift_task import LiftTask
from planners.certify.plan_view import PlanView
from planners.certify.scene_facts import compare_body
from planners.certify.settings import CertifySettings
from planners.geometry.pose import inverse
from planners.plan.verdicts import Check

_CABLE_LENGTH = 1.1
"""Contract [m]."""


def lift_bodies_check(plan: PlanView, task: LiftTask, settings: CertifySettings) -> Check:
    """Check the bodies against the task, and the lifter's cup and cable."""
    finding = Finding("task_bodies", "m, kg")
    for stated in task.bodies:
        body = plan.bodies.get(stated.name)
        if body is None:
            finding.require(False, f"body {stated.name}", "is in the task, not in the document")
        else:
            compare_body(body, stated, finding, settings)
    roles = {"plate": "plate", "support": "support", "cup": "cup", "cable": "cable"}
    roles |= {stated.name: "obstacle" for stated in task.bodies if stated.name not in roles}
    for name, body in plan.bodies.items():
        where, fixed = f"body {name}", name not in ("plate", "cup", "cable")
        # Whatever the task does not state belongs to the cell.
        known = body.role == roles[name] if name in roles else body.role in ("table", "frame")
        finding.require(known, f"{where}: role", f"{body.role!r} is not what the task makes of it")
        finding.require(body.static == fixed, f"{where}: static", f"must be {fixed}")
    for name in ("cup", "cable", plan.support):
        finding.require(name in plan.bodies, f"body {name}", "is missing")
    if {"cup", "cable"} <= set(plan.bodies):
        _lifter(plan, task, finding, settings)
    return finding.check()


def _lifter(plan: PlanView, task: LiftTask, finding: Finding, settings: CertifySettings) -> None:
    """The cup stands on the plate where the task says and is as wide; the cable stands on the cup, 1.1 m high."""
    plate, cup, cable = (plan.bodies[name] for name in ("plate", "cup", "cable"))
    T_plate_cup = inverse(plate.T_world_start) @ cup.T_world_start
    rim = cup.shape.vertices @ T_plate_cup[:3, :3].T + T_plate_cup[:3, 3]
    middle = (rim.min(axis=0) + rim.max(axis=0)) / 2
    seat = np.array([*task.cup.position, plate.shape.vertices[:, 2].max()])
    off = np.linalg.norm(seat - [middle[0], middle[1], rim[:, 2].min()])
    finding.note(settings.attachment_distance - float(off), "body cup: place on the plate")
    narrower = task.cup.radius - float(np.linalg.norm(rim[:, :2] - middle[:2], axis=1).max())
    finding.note(settings.join - narrower, "body cup: radius")
    low, high = cable.shape.vertices[:, 2].min(), cable.shape.vertices[:, 2].max()
    finding.note(settings.join - (_CABLE_LENGTH - float(high - low)), "body cable: height")
    foot = cable.T_world_start[:3, :3] @ [0.0, 0.0, low] + cable.T_world_start[:3, 3]
    T = plate.T_world_start
    anchor = T[:3, :3] @ [middle[0], middle[1], rim[:, 2].max()] + T[:3, 3]
    finding.note(settings.attachment_distance - float(np.linalg.norm(foot - anchor)), "body cable: place on the cup")
