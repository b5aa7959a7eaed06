"""From the motion of a plate lift to the segments of its plan: forces in world axes, and what limits them."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from planners.contract.arrays import rounded
from planners.geometry.pose import Array, pose_row, to_pose7s
from planners.manipulation.lift_plan import LiftPlan
from planners.manipulation.lift_segment import BalancedContacts, GripHold, LiftSegment
from planners.manipulation.statics.lift_programs import hand_force_limit
from planners.plan.contacts import Contact, EnvironmentContact, PointContact, SoftFingerContact, SuctionContact
from planners.plan.segment import Attachment, ContactState, Grip, Hold, Push, Segment, SegmentKind
from planners.scene.lift_scene import PlateLiftScene

_RESERVE_DIGITS = 9
"""Decimals of reserves: they are found in steps of a half percent."""


def plan_segments(plan: LiftPlan, scene: PlateLiftScene) -> Iterator[Segment]:
    """Yield the segments of a plan, one after the other in time."""
    begin = 0.0
    for segment, reserve in zip(plan.segments, () if plan.reserves is None else plan.reserves.samples, strict=True):
        held = segment.grip is not None or segment.push is not None
        stated = _segment(segment, scene, begin, np.round(reserve, _RESERVE_DIGITS) if held else None)
        begin = stated.end
        yield stated


def _segment(segment: LiftSegment, scene: PlateLiftScene, begin: float, reserve: Array | None) -> Segment:
    trajectory = segment.trajectory
    touched = None if segment.contact.plate is None else scene.support_name
    return Segment(
        kind=segment.kind,
        movers=list(segment.movers),
        time=rounded(trajectory.time + begin),
        positions=trajectory.positions,
        velocities=trajectory.velocities,
        accelerations=trajectory.accelerations,
        gripper_width=dict(segment.widths),
        contact_state=ContactState(
            **{"with": touched},
            element=segment.contact.element,
            index=segment.contact.index,
            vertices=segment.contact_points,
        ),
        hold=_hold(segment, scene.squeeze),
        attached=_attached(segment, scene),
        body_poses=_body_poses(segment, scene),
        contacts=[each for contact_set in segment.contact_sets for each in _contacts(contact_set, segment, scene)],
        reserve=reserve,
    )


def _hold(segment: LiftSegment, squeeze: float | None) -> Hold | None:
    grip, push = segment.grip, segment.push
    if grip is None and push is None:
        return None
    return Hold(
        grip=None if grip is None else _grip(grip, squeeze),
        push=None if push is None else Push(arm=push.arm, body="plate", point=push.point, normal=push.normal),
    )


def _grip(grip: GripHold, squeeze: float | None) -> Grip:
    pose = pose_row(grip.T_body_tcp)
    return Grip(arm=grip.arm, body="plate", pose=pose, width=grip.width, squeeze=squeeze)


def _attached(segment: LiftSegment, scene: PlateLiftScene) -> dict[str, list[Attachment]]:
    attached = {"cup": [Attachment(to="plate", pose=pose_row(scene.cup.T_plate_cup_body))]}
    if segment.grip is not None and segment.kind not in (SegmentKind.GRIP, SegmentKind.RELEASE):
        attached["plate"] = [Attachment(to=segment.grip.arm, pose=pose_row(segment.grip.T_flange_body))]
    return attached


def _body_poses(segment: LiftSegment, scene: PlateLiftScene) -> dict[str, Array]:
    """Return poses (n, 7) of plate, cup and cable where the plate moves."""
    if segment.kind is not SegmentKind.TRANSFER:
        return {}
    cup = segment.T_world_body @ scene.cup.T_plate_cup_body
    cable = np.repeat(np.eye(4)[None], len(cup), axis=0)
    anchor = scene.cup.cable_anchor
    cable[:, :3, 3] = segment.T_world_body[:, :3, :3] @ anchor + segment.T_world_body[:, :3, 3]
    cable[:, 2, 3] += 0.5 * scene.cup.cable_length
    moving = {"plate": segment.T_world_body, "cup": cup, "cable": cable}
    return {name: to_pose7s(poses) for name, poses in moving.items()}


def _contacts(contact_set: BalancedContacts, segment: LiftSegment, scene: PlateLiftScene) -> Iterator[Contact]:
    """Put one set of contacts into world axes, and say of each who exerts it, of what kind it is and what limits it."""
    balance, T_world_plate = contact_set.balance, segment.T_world_body[contact_set.sample]
    friction, limits, cup, R = scene.friction, hand_force_limit(scene), scene.cup, T_world_plate[:3, :3]
    for number, name in enumerate(balance.contacts):
        common = {
            "sample": contact_set.sample,
            "body": "plate",
            "finger": None,
            "point": R @ balance.points[number] + T_world_plate[:3, 3],
            "normal": R @ balance.rotations[number][:, 2],
            "wrench": balance.wrenches_world[number],
        }
        kind, _, finger = name.partition("_")
        if kind == "grip":
            assert segment.grip is not None
            common["finger"] = 1 - int(finger) if segment.grip.flipped else int(finger)
            yield SoftFingerContact(
                **common, by=segment.grip.arm, kind="soft_finger", mu=friction.grip, eps=friction.eps,
                limit=limits.finger, squeeze=limits.squeeze,
            )  # fmt: skip
        elif kind == "push":
            assert segment.push is not None
            yield PointContact(**common, by=segment.push.arm, kind="point", mu=friction.push, limit=limits.pushing)
        elif kind == "environment":
            yield EnvironmentContact(
                **common, by=scene.support_name, kind="environment", mu=friction.environment, limit=None
            )
        else:
            yield SuctionContact(
                **common, by="cup", kind="suction", mu=cup.mu, radius=cup.radius, kappa=cup.kappa,
                limit=cup.max_force, suction_force=balance.suction_force, x_axis=R @ cup.T_plate_cup[:3, 0],
            )  # fmt: skip
