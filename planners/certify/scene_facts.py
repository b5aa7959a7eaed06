"""The document's bodies are those of its task, and its cell is the cell that it names."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from planners.certify.body_shape import BodyShape
from planners.certify.certificate import Check, Finding
from planners.certify.document_view import BodyView, PlanView
from planners.certify.lift_task import LiftTask, StatedBody
from planners.certify.settings import CertifySettings
from planners.certify.surfaces import largest_width, pad_height
from planners.geometry.pose import Array, inverse

_CABLE_LENGTH = 1.1
"""Contract [m]."""


@dataclass(frozen=True, eq=False)
class CellReference:
    """What is known about the cell without the document."""

    cell: Mapping[str, Any]
    """The member `cell` that documents of this cell carry."""
    bodies: Mapping[str, Any]
    """Its static bodies, as documents carry them."""
    home: Array
    """(12,) where the arms start when the task does not say [rad]."""


def scene_checks(
    plan: PlanView,
    document: Mapping[str, Any],
    task: LiftTask,
    reference: CellReference | None,
    settings: CertifySettings,
) -> list[Check]:
    """Check bodies against the task, hands against their kinematics, and the cell against what is known of it."""
    checks = [_bodies(plan, task, settings), _grippers(plan, settings)]
    if reference is not None:
        checks.insert(0, _cell(document, reference, settings))
    return checks


def _bodies(plan: PlanView, task: LiftTask, settings: CertifySettings) -> Check:
    finding = Finding("task_bodies", "m, kg")
    for stated in task.bodies:
        body = plan.bodies.get(stated.name)
        if body is None:
            finding.require(False, f"body {stated.name}", "is in the task, not in the document")
        else:
            _same_body(body, stated, finding, settings)
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


def _same_body(body: BodyView, stated: StatedBody, finding: Finding, settings: CertifySettings) -> None:
    differences = {"pose": float(np.abs(body.T_world_start - stated.T_world_body).max())}
    if stated.shape is not None:
        differences["shape"] = _difference(body.shape, stated.shape)
    if stated.com is not None:
        differences["com"] = float(np.abs(body.com - stated.com).max())
    if stated.mass is not None:
        differences["mass"] = abs((body.mass or 0.0) - stated.mass)
    for member, difference in differences.items():
        finding.note(settings.join - difference, f"body {stated.name}: {member}")


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


def _difference(a: BodyShape, b: BodyShape) -> float:
    if a.vertices.shape != b.vertices.shape:
        return 1.0
    distances = np.linalg.norm(a.vertices[:, None] - b.vertices[None], axis=2)
    return float(max(distances.min(axis=0).max(), distances.min(axis=1).max()))


def _grippers(plan: PlanView, settings: CertifySettings) -> Check:
    """The table of pad heights must be the linkage's, and every opening one that the gripper has."""
    finding = Finding("gripper", "m")
    for arm, hand in plan.hands.items():
        if hand.tcp_table is None:
            continue
        widths, heights = hand.tcp_table.T
        finding.note_all(
            settings.attachment_distance - np.abs(pad_height(widths) - heights),
            lambda i, a=arm: f"cell: row {i} of the {a} hand's tcp table",
        )
        for segment in plan.segments:
            opening = segment.widths[arm]
            outside = np.maximum(-opening, opening - min(largest_width(), float(widths[-1])))
            finding.note_all(
                settings.attachment_distance - outside, lambda i, a=arm, s=segment: f"{s.place(i)}: opening of {a}"
            )
    return finding.check()


def _cell(document: Mapping[str, Any], reference: CellReference, settings: CertifySettings) -> Check:
    finding = Finding("cell", "1")
    _compare(document["cell"], reference.cell, "/cell", finding, settings.join)
    for name, body in reference.bodies.items():
        _compare(document["bodies"].get(name), body, f"/bodies/{name}", finding, settings.join)
    return finding.check()


def _compare(value: Any, known: Any, pointer: str, finding: Finding, tolerance: float) -> None:
    """Note the first difference between two JSON values; numbers may differ by `tolerance`."""
    if isinstance(known, Mapping) and isinstance(value, Mapping):
        for key in sorted(set(known) | set(value)):
            if key not in known or key not in value:
                finding.note(-1.0, f"{pointer}/{key}")
            else:
                _compare(value[key], known[key], f"{pointer}/{key}", finding, tolerance)
    elif isinstance(known, (list, tuple)) and isinstance(value, (list, tuple)) and len(known) == len(value):
        for index, (a, b) in enumerate(zip(value, known, strict=True)):
            _compare(a, b, f"{pointer}/{index}", finding, tolerance)
    elif isinstance(known, (int, float)) and isinstance(value, (int, float)) and not isinstance(value, bool):
        finding.note(tolerance - abs(float(value) - float(known)), pointer)
    else:
        finding.note(0.0 if value == known else -1.0, pointer)
