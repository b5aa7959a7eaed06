"""From a finished suction-tool plan to its plan document: the only place that knows both sides."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from planners.contract.considered_members import considered_members
from planners.contract.document_members import document_of, motion_members, pose_rows, significant
from planners.contract.task_spec import SuctionToolTask
from planners.geometry.pose import Array, to_pose7
from planners.regrasp.statics.hold_statics import EPS, pad_axes
from planners.regrasp.tool_plan import ToolPlan
from planners.regrasp.tool_segment import ContactForce, ToolContactSet, ToolHold, ToolSegment
from planners.scene.suction_tool import TOOL_NAME
from planners.scene.tool_scene import SuctionToolScene
from planners.segment import SegmentKind


def tool_document(
    task: SuctionToolTask, scene: SuctionToolScene, plan: ToolPlan, stages: Mapping[str, float]
) -> dict[str, Any]:
    """Return the document of a plan, complete but for what only the caller knows: id, software, certificate.

    Args:
        task: as accepted.
        scene: what was planned in.
        plan: what came out, with its contact sets.
        stages: seconds by stage, in order.
    """
    document = document_of(task, scene, plan, tool_segments(plan.segments, scene), stages)
    document["statistics"]["reserve"] = _least_reserve(plan.segments)
    document["statistics"]["considered"] = considered_members(plan)
    return document


def tool_segments(segments: Sequence[ToolSegment], scene: SuctionToolScene) -> Iterator[dict[str, Any]]:
    """Yield the segments of the document, one after the other in time."""
    begun = 0.0
    places = {body.name: body.T_world_body for body in scene.bodies()}
    for segment in segments:
        document = {
            **motion_members(segment, begun),
            "contact_state": None,
            "hold": _hold(segment, scene),
            "attached": _attached(segment),
            "body_poses": {name: pose_rows(poses) for name, poses in segment.body_poses.items()},
            "contacts": list(_contacts(segment, places, scene)),
            "reserve": _reserve(segment),
        }
        begun = document["time"][-1]
        places |= {name: poses[-1] for name, poses in segment.body_poses.items()}
        yield document


def _hold(segment: ToolSegment, scene: SuctionToolScene) -> dict[str, Any] | None:
    if not segment.holds:
        return None
    grips = [_grip(hold, scene.squeeze) for hold in segment.holds]
    return {"grip": grips[0], "push": None, "second_grip": grips[1] if len(grips) > 1 else None}


def _grip(hold: ToolHold, squeeze: float) -> dict[str, Any]:
    pose = to_pose7(hold.T_tool_tcp)
    return {"arm": hold.arm, "body": TOOL_NAME, "pose": pose, "width": hold.width, "squeeze": squeeze}


def _reserve(segment: ToolSegment) -> list[float | None]:
    if segment.reserve is None:
        return [None] * len(segment.trajectory.time)
    return significant(segment.reserve.values)


def _least_reserve(segments: Sequence[ToolSegment]) -> dict[str, Any] | None:
    """Return where least of the limits is left along a plan; None where nothing is held."""
    held = [(index, each.reserve) for index, each in enumerate(segments) if each.reserve is not None]
    if not held:
        return None
    index, least = min(held, key=lambda each: each[1].least)
    return {
        "value": significant(np.array([least.least]))[0],
        "limited_by": least.limited_by,
        "body": least.body,
        "segment": index,
        "sample": least.sample,
    }


def _attached(segment: ToolSegment) -> dict[str, Any]:
    """Attach the tool while no fingers act on it, and the object while no vacuum goes on or off."""
    attached: dict[str, Any] = {}
    if segment.holds and segment.kind not in (SegmentKind.GRIP, SegmentKind.RELEASE):
        attached[TOOL_NAME] = [{"to": hold.arm, "pose": to_pose7(hold.T_flange_tool)} for hold in segment.holds]
    if segment.sucked is not None and segment.kind not in (SegmentKind.ATTACH, SegmentKind.DETACH):
        attached[segment.sucked.name] = [{"to": TOOL_NAME, "pose": to_pose7(segment.sucked.T_tool_object)}]
    return attached


def _contacts(segment: ToolSegment, places: Mapping[str, Array], scene: SuctionToolScene) -> Iterator[dict[str, Any]]:
    """Yield all contacts of a segment; their numbers are written all at once, as there are thousands."""
    stated = [(each, force) for each in segment.contact_sets for force in each.forces]
    if not stated:
        return
    points, normals, wrenches = (
        significant(np.array(rows))
        for rows in zip(*((force.point, force.normal, force.wrench) for _, force in stated), strict=True)
    )
    of_cup = iter(_cup_members([entry for entry in stated if entry[1].kind == "suction"], segment, places, scene))
    for (contact_set, force), point, normal, wrench in zip(stated, points, normals, wrenches, strict=True):
        inertia = force.kind == "inertia"
        yield {
            "sample": contact_set.sample,
            "body": contact_set.body,
            "by": None if inertia else force.by,
            "finger": force.finger,
            "kind": force.kind,
            "point": point,
            "normal": None if inertia else normal,
            "wrench": wrench,
            **(next(of_cup) if force.kind == "suction" else _parameters(force, scene)),
        }


def _parameters(force: ContactForce, scene: SuctionToolScene) -> dict[str, Any]:
    """Return what limits a contact that is not the cup's."""
    if force.kind == "soft_finger":
        limit = scene.finger_limit(force.by)
        return {"mu": scene.friction.grip, "eps": EPS, "limit": limit, "squeeze": scene.squeeze}
    if force.kind == "environment":
        return {"mu": scene.friction.environment, "limit": None}
    return {}


def _cup_members(
    stated: Sequence[tuple[ToolContactSet, ContactForce]],
    segment: ToolSegment,
    places: Mapping[str, Array],
    scene: SuctionToolScene,
) -> Iterator[dict[str, Any]]:
    """Yield what limits the cup in each of its contacts, and how hard it pulls."""
    if not stated:
        return
    cup, moving = scene.tool.cup, segment.body_poses
    normals = np.array([force.normal for _, force in stated])
    forces = np.array([force.wrench[:3] for _, force in stated])
    T_world_bodies = np.array(
        [moving[each.body][each.sample] if each.body in moving else places[each.body] for each, _ in stated]
    )
    pulls = significant(-np.einsum("ij,ij->i", forces, normals))
    axes = significant(pad_axes(T_world_bodies, normals))
    limits = {"mu": cup.mu, "radius": cup.radius, "kappa": cup.kappa, "limit": cup.max_force}
    for pull, axis in zip(pulls, axes, strict=True):
        yield {**limits, "suction_force": pull, "x_axis": axis}
