"""From a finished suction-tool plan to its plan document: the only place that knows both sides."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from planners.contract.considered_members import considered_members
from planners.contract.document_members import document_of, motion_members, pose_row, significant
from planners.contract.task_spec import SuctionToolTask
from planners.geometry.pose import Array, to_pose7
from planners.regrasp.hold_statics import EPS, pad_axes
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
            "hold": _hold(segment),
            "attached": _attached(segment),
            "body_poses": {name: [pose_row(T) for T in poses] for name, poses in segment.body_poses.items()},
            "contacts": [
                contact
                for contact_set in segment.contact_sets
                for contact in _contacts(contact_set, segment, places, scene)
            ],
        }
        begun = document["time"][-1]
        places |= {name: poses[-1] for name, poses in segment.body_poses.items()}
        yield document


def _hold(segment: ToolSegment) -> dict[str, Any] | None:
    if not segment.holds:
        return None
    first, second = segment.holds[0], segment.holds[1] if len(segment.holds) > 1 else None
    return {"grip": _grip(first), "push": None, "second_grip": None if second is None else _grip(second)}


def _grip(hold: ToolHold) -> dict[str, Any]:
    return {"arm": hold.arm, "body": TOOL_NAME, "pose": to_pose7(hold.T_tool_tcp), "width": hold.width}


def _attached(segment: ToolSegment) -> dict[str, Any]:
    """Attach the tool while no fingers act on it, and the object while no vacuum goes on or off."""
    attached: dict[str, Any] = {}
    if segment.holds and segment.kind not in (SegmentKind.GRIP, SegmentKind.RELEASE):
        attached[TOOL_NAME] = [{"to": hold.arm, "pose": to_pose7(hold.T_flange_tool)} for hold in segment.holds]
    if segment.sucked is not None and segment.kind not in (SegmentKind.ATTACH, SegmentKind.DETACH):
        attached[segment.sucked.name] = [{"to": TOOL_NAME, "pose": to_pose7(segment.sucked.T_tool_object)}]
    return attached


def _contacts(
    contact_set: ToolContactSet, segment: ToolSegment, places: Mapping[str, Array], scene: SuctionToolScene
) -> Iterator[dict[str, Any]]:
    poses = segment.body_poses.get(contact_set.body)
    T_world_body = places[contact_set.body] if poses is None else poses[contact_set.sample]
    for force in contact_set.forces:
        inertia = force.kind == "inertia"
        yield {
            "sample": contact_set.sample,
            "body": contact_set.body,
            "by": None if inertia else force.by,
            "finger": force.finger,
            "kind": force.kind,
            "point": significant(force.point),
            "normal": None if inertia else significant(force.normal),
            "wrench": significant(force.wrench),
            **_parameters(force, T_world_body, scene),
        }


def _parameters(force: ContactForce, T_world_body: Array, scene: SuctionToolScene) -> dict[str, Any]:
    """Return what limits a contact."""
    if force.kind == "soft_finger":
        return {"mu": scene.friction.grip, "eps": EPS, "limit": scene.grip_force_limit}
    if force.kind == "environment":
        return {"mu": scene.friction.environment, "limit": None}
    if force.kind == "inertia":
        return {}
    cup = scene.tool.cup
    pull = -float(force.wrench[:3] @ force.normal)
    return {
        "mu": cup.mu, "radius": cup.radius, "kappa": cup.kappa, "limit": cup.max_force,
        "suction_force": significant(np.array([pull]))[0],
        "x_axis": significant(pad_axes(T_world_body[None], force.normal[None])[0]),
    }  # fmt: skip
