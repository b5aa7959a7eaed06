"""The cell of the document is the cell that it names, its hands are what they are, its bodies those of the task."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydantic import BaseModel, JsonValue

from planners.certify.evidence import CellReference, Evidence
from planners.certify.finding import Finding
from planners.certify.geometry.body_shape import BodyShape, closed_surface
from planners.certify.geometry.cover import beyond_parts
from planners.certify.motion.segment_motion import rotation_angles
from planners.certify.motion.solids import gripper_of
from planners.certify.plan_view import BodyView, MalformedDocument, shape_of
from planners.certify.settings import CertifySettings
from planners.contract.shapes import Box, Cylinder, InlineMesh, Mesh, Prism
from planners.contract.task_spec import PlateLiftTask, SuctionToolFriction, SuctionToolTask
from planners.geometry.pose import Array, Transform, from_pose7
from planners.plan.plan import Plan
from planners.plan.scenery import BodyDocument, CellDocument
from planners.plan.verdicts import Check

_KNOWN_HERE = {(SuctionToolFriction, "eps")}
"""What documents say only where it is not what it was before a task could say it, which the certificate knows."""
_OPTIONAL = frozenset(
    {
        *("contact_model", "mass_tolerance", "com_tolerance", "squeeze", "carry_force_limit"),
        *("cell", "scene_id", "scene_filled", "external_id", "seed"),
        *(
            "reserve",
            "remedies",
            "minimise",
            "search",
            "simulate",
            "contact_density",
            "hold_density",
            "grips",
            "pushes",
        ),
    }
)
"""Members that tasks of 0.1.0 do not have, or that say nothing about the plan."""


_MOVABLE = ("plate", "cup", "cable", "tool", "object")
"""Roles of bodies that are not fixed."""
_OF_THE_CELL = ("table", "frame")
"""Roles of bodies that come with the cell."""


@dataclass(frozen=True, eq=False)
class StatedBody:
    """A body as the task places it."""

    name: str
    shape: BodyShape | None
    """None for a mesh that the task names by upload, or by an asset of which nothing is known."""
    T_world_body: Transform
    mass: float | None = None
    com: Array | None = None
    settled: bool = False
    """Whether it may be a little off its pose, on what carries it."""


def require_stated(stated: Any, pointer: str = "/task") -> None:
    """Refuse a task that leaves a default to its reader: it has to hold whatever defaults there are later.

    Raises:
        MalformedDocument: a member is not stated.
    """
    if isinstance(stated, tuple):
        for index, each in enumerate(stated):
            require_stated(each, f"{pointer}/{index}")
    elif isinstance(stated, BaseModel):
        for name in type(stated).model_fields:
            if name in stated.model_fields_set:
                require_stated(getattr(stated, name), f"{pointer}/{name}")
            elif name not in _OPTIONAL and (type(stated), name) not in _KNOWN_HERE:
                raise MalformedDocument(f"{pointer}/{name}", "is missing")


def stated_shape(
    shape: Box | Cylinder | Prism | Mesh | InlineMesh, pointer: str, reference: CellReference | None
) -> BodyShape | None:
    """Return a shape; None for a mesh of which nothing is known but its name."""
    if not isinstance(shape, Mesh):
        return shape_of(shape, pointer)
    known = None if reference is None or shape.asset is None else reference.meshes.get(shape.asset)
    return None if known is None else closed_surface(shape.scale * known)


def stated_obstacles(task: PlateLiftTask | SuctionToolTask, reference: CellReference | None) -> list[StatedBody]:
    """Return the obstacles of a task."""
    return [
        StatedBody(each.name, stated_shape(each.shape, f"/task/obstacles/{i}/shape", reference), from_pose7(each.pose))
        for i, each in enumerate(task.obstacles)
    ]


def cell_checks(evidence: Evidence) -> list[Check]:
    """Check the cell against what is known of it, and the hands against their kinematics."""
    known = [] if evidence.reference is None else [_cell(evidence.plan.stated, evidence.reference, evidence.settings)]
    return [*known, _grippers(evidence)]


def task_bodies(evidence: Evidence, stated: Sequence[StatedBody], roles: Mapping[str, str]) -> Finding:
    """Compare the bodies of the document with those of the task; meshes must be inside their convex parts.

    Args:
        evidence: of the document.
        stated: the bodies that the task places.
        roles: of the bodies that come with the task, by name; whatever else there is belongs to the cell.
    """
    finding, bodies = Finding("task_bodies", "m, kg"), evidence.plan.bodies
    for each in stated:
        if each.name in bodies:
            _compare_body(bodies[each.name], each, finding, evidence.settings)
        else:
            finding.require(False, f"body {each.name}", "is in the task, not in the document")
    for name, body in bodies.items():
        known = body.role == roles[name] if name in roles else body.role in _OF_THE_CELL
        finding.require(known, f"body {name}: role", f"{body.role!r} is not what the task makes of it")
        fixed = roles.get(name) not in _MOVABLE
        finding.require(body.static == fixed, f"body {name}: static", f"must be {fixed}")
        _covered(body, finding, evidence.settings)
    return finding


def _compare_body(body: BodyView, stated: StatedBody, finding: Finding, settings: CertifySettings) -> None:
    differences = {}
    if stated.settled:
        compare_settled(body, stated.T_world_body, finding, settings)
    else:
        differences["pose"] = float(np.abs(body.T_world_start - stated.T_world_body).max())
    if stated.shape is not None:
        differences["shape"] = _difference(body.shape, stated.shape)
    if stated.com is not None:
        differences["com"] = float(np.abs(body.com - stated.com).max())
    if stated.mass is not None:
        differences["mass"] = abs((body.mass or 0.0) - stated.mass)
    for member, difference in differences.items():
        finding.note(settings.join - difference, f"body {stated.name}: {member}")


def _covered(body: BodyView, finding: Finding, settings: CertifySettings) -> None:
    """The convex parts of a mesh, by which collisions are judged, contain its surface."""
    if body.shape.surface is None:
        return
    height, point = beyond_parts(body.shape, settings.contact_distance)
    finding.note(
        settings.contact_distance - height, f"body {body.name}: convex parts, at {np.round(point, 4).tolist()}"
    )


def compare_settled(body: BodyView, T_world_stated: Transform, finding: Finding, settings: CertifySettings) -> None:
    """Note how far a body was moved from its stated pose onto what carries it."""
    where = f"body {body.name}: pose"
    moved = float(np.linalg.norm(body.T_world_start[:3, 3] - T_world_stated[:3, 3]))
    finding.note(settings.settled_distance + settings.join - moved, where)
    turned = float(rotation_angles(body.T_world_start[None], T_world_stated)[0])
    finding.note(settings.settled_angle + settings.join - turned, where)


def _difference(a: BodyShape, b: BodyShape) -> float:
    """Return how far corners of two shapes are from one another, or their surfaces on the average [m].

    Of a mesh the corners tell too little: it may list some that it does not use.
    """
    if a.vertices.shape != b.vertices.shape:
        return 1.0
    distances = np.linalg.norm(a.vertices[:, None] - b.vertices[None], axis=2)
    apart = max(distances.min(axis=0).max(), distances.min(axis=1).max())
    if a.surface is not None or b.surface is not None:
        (enclosed, _), (stated, area) = _volume_and_area(a), _volume_and_area(b)
        apart = max(apart, abs(enclosed - stated) / area)
    return float(apart)


def _volume_and_area(shape: BodyShape) -> tuple[float, float]:
    """Return what a shape's outward triangles enclose [m^3], and their area [m^2]."""
    a, b, c = np.swapaxes(shape.triangles, 0, 1)
    doubled = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    return float(np.einsum("ij,ij->", a, np.cross(b, c))) / 6.0, float(doubled.sum()) / 2.0


def _grippers(evidence: Evidence) -> Check:
    """The table of pad heights must be the linkage's, and every opening one that the gripper has."""
    finding, tolerance = Finding("gripper", "m"), evidence.settings.attachment_distance
    for arm, gripper in evidence.plan.grippers.items():
        known = gripper_of(arm, evidence.surfaces)
        widths, heights = gripper.tcp.T
        off = np.abs(known.pad_height(widths) - heights)
        finding.note_all(tolerance - off, lambda i, a=arm: f"cell: row {i} of the {a} hand's tcp table")
        for segment in evidence.plan.segments:
            opening = segment.gripper_width[arm]
            outside = np.maximum(-opening, opening - min(known.fingers.largest_width, float(widths[-1])))
            finding.note_samples(segment, tolerance - outside, f"opening of {arm}")
    return finding.check()


def _cell(plan: Plan, reference: CellReference, settings: CertifySettings) -> Check:
    finding = Finding("cell", "1")
    _compare(_members(plan.cell), _members(reference.cell), "/cell", finding, settings.join)
    for name, body in reference.bodies.items():
        stated = plan.bodies.get(name)
        where = f"/bodies/{name}"
        _compare(None if stated is None else _members(stated), _members(body), where, finding, settings.join)
    for name, body in plan.bodies.items():
        strange = body.role in _OF_THE_CELL and name not in reference.bodies
        finding.require(not strange, f"/bodies/{name}", "the cell has no such body")
    return finding.check()


def _members(stated: CellDocument | BodyDocument) -> JsonValue:
    return stated.model_dump(mode="json", exclude_unset=True)


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
