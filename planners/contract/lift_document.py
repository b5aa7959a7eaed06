"""From a finished plate lift to its plan document: the only place that knows both sides."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict
from typing import Any

import numpy as np

from planners.balance.balanced import Balanced
from planners.contract.document_members import document_of, motion_members, pose_rows, rounded
from planners.contract.task_spec import PlateLiftTask
from planners.geometry.pose import Array, to_pose7
from planners.manipulation.lift_plan import LiftPlan
from planners.manipulation.statics.lift_programs import hand_force_limit
from planners.scene.scene import PlateLiftScene
from planners.segment import ContactSet, Segment, SegmentKind

_RESERVE_DIGITS = 9
"""Decimals of reserves: they are found in steps of a half percent."""


def lift_document(
    task: PlateLiftTask, scene: PlateLiftScene, plan: LiftPlan, stages: Mapping[str, float]
) -> dict[str, Any]:
    """Return the document of a plan, complete but for what only the caller knows: id, software, certificate.

    Args:
        task: as accepted.
        scene: what was planned in.
        plan: what came out.
        stages: seconds by stage, in order.
    """
    document = document_of(task, scene, plan, _segments(plan, scene), stages)
    if plan.reserve is not None:
        document["statistics"]["reserve"] = asdict(plan.reserve)
    return document


def _segments(plan: LiftPlan, scene: PlateLiftScene) -> Iterator[dict[str, Any]]:
    begun = 0.0
    for segment, reserve in zip(plan.segments, () if plan.reserves is None else plan.reserves.samples, strict=True):
        document = _segment(segment, scene, begun)
        begun = document["time"][-1]
        held = segment.grip is not None or segment.push is not None
        document["reserve"] = rounded(reserve, _RESERVE_DIGITS) if held else None
        yield document


def _segment(segment: Segment, scene: PlateLiftScene, begun: float) -> dict[str, Any]:
    return {
        **motion_members(segment, begun),
        "contact_state": {
            "element": segment.contact.element,
            "index": segment.contact.index,
            "with": None if segment.contact.plate is None else scene.support_name,
            "vertices": segment.contact_points.tolist(),
        },
        "hold": _hold(segment, scene.squeeze),
        "attached": _attached(segment, scene),
        "body_poses": _body_poses(segment, scene),
        "contacts": [
            contact for contact_set in segment.contact_sets for contact in _contacts(contact_set, segment, scene)
        ],
    }


def _hold(segment: Segment, squeeze: float | None) -> dict[str, Any] | None:
    grip, push = segment.grip, segment.push
    if grip is None and push is None:
        return None
    return {
        "grip": None
        if grip is None
        else {
            "arm": grip.arm,
            "body": "plate",
            "pose": to_pose7(grip.T_body_tcp),
            "width": grip.width,
            "squeeze": squeeze,
        },
        "push": None
        if push is None
        else {"arm": push.arm, "body": "plate", "point": push.point.tolist(), "normal": push.normal.tolist()},
    }


def _attached(segment: Segment, scene: PlateLiftScene) -> dict[str, Any]:
    attached = {"cup": [{"to": "plate", "pose": to_pose7(scene.cup.T_plate_cup_body)}]}
    if segment.grip is not None and segment.kind not in (SegmentKind.GRIP, SegmentKind.RELEASE):
        attached["plate"] = [{"to": segment.grip.arm, "pose": to_pose7(segment.grip.T_flange_body)}]
    return attached


def _body_poses(segment: Segment, scene: PlateLiftScene) -> dict[str, Any]:
    """Poses of plate, cup and cable where the plate moves."""
    if segment.kind is not SegmentKind.TRANSFER:
        return {}
    cup = segment.T_world_body @ scene.cup.T_plate_cup_body
    cable = np.repeat(np.eye(4)[None], len(cup), axis=0)
    anchor = scene.cup.cable_anchor
    cable[:, :3, 3] = segment.T_world_body[:, :3, :3] @ anchor + segment.T_world_body[:, :3, 3]
    cable[:, 2, 3] += 0.5 * scene.cup.cable_length
    moving = {"plate": segment.T_world_body, "cup": cup, "cable": cable}
    return {name: pose_rows(poses) for name, poses in moving.items()}


def _contacts(contact_set: ContactSet, segment: Segment, scene: PlateLiftScene) -> Iterator[dict[str, Any]]:
    """Put one set of contacts into world axes."""
    balance, T_world_plate = contact_set.balance, segment.T_world_body[contact_set.sample]
    R = T_world_plate[:3, :3]
    for number, name in enumerate(balance.contacts):
        yield {
            "sample": contact_set.sample,
            "body": "plate",
            "finger": None,
            "point": rounded(R @ balance.points[number] + T_world_plate[:3, 3]),
            "normal": rounded(R @ balance.rotations[number][:, 2]),
            "wrench": rounded(balance.wrenches_world[number]),
            **_parameters(name, balance, segment, scene, R),
        }


def _parameters(name: str, balance: Balanced, segment: Segment, scene: PlateLiftScene, R: Array) -> dict[str, Any]:
    """Say who exerts a contact, of what kind it is and what limits it."""
    friction, limits = scene.friction, hand_force_limit(scene)
    kind, _, number = name.partition("_")
    if kind == "grip":
        assert segment.grip is not None
        finger = 1 - int(number) if segment.grip.flipped else int(number)
        return {
            "by": segment.grip.arm, "finger": finger, "kind": "soft_finger", "mu": friction.grip,
            "eps": friction.eps, "limit": limits.finger, "squeeze": limits.squeeze,
        }  # fmt: skip
    if kind == "push":
        assert segment.push is not None
        return {"by": segment.push.arm, "kind": "point", "mu": friction.push, "limit": limits.pushing}
    if kind == "environment":
        return {"by": scene.support_name, "kind": "environment", "mu": friction.environment, "limit": None}
    cup = scene.cup
    return {
        "by": "cup", "kind": "suction", "mu": cup.mu, "radius": cup.radius, "kappa": cup.kappa,
        "limit": cup.max_force, "suction_force": balance.suction_force,
        "x_axis": rounded(R @ cup.T_plate_cup[:3, 0]),
    }  # fmt: skip
