"""From the motion of a suction-tool plan to the segments of its plan: what is held, attached, and borne."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from planners.contract.arrays import rounded, significant
from planners.geometry.pose import Array, pose_row, to_pose7s
from planners.plan.contacts import Contact, EnvironmentContact, InertiaEntry, SoftFingerContact, SuctionContact
from planners.plan.segment import Attachment, Grip, Hold, Segment, SegmentKind
from planners.plan.verdicts import LeastReserve
from planners.regrasp.statics.hold_statics import pad_axes
from planners.regrasp.tool_segment import ExertedForce, ToolContactSet, ToolHold, ToolSegment
from planners.scene.suction_tool import TOOL_NAME
from planners.scene.tool_scene import SuctionToolScene


def plan_segments(segments: Sequence[ToolSegment], scene: SuctionToolScene) -> Iterator[Segment]:
    """Yield the segments of a plan, one after the other in time."""
    begin = 0.0
    places = {body.name: body.T_world_body for body in scene.bodies()}
    for segment in segments:
        trajectory, poses = segment.trajectory, segment.body_poses
        stated = Segment(
            kind=segment.kind,
            movers=list(segment.movers),
            time=rounded(trajectory.time + begin),
            positions=trajectory.positions,
            velocities=trajectory.velocities,
            accelerations=trajectory.accelerations,
            gripper_width=dict(segment.widths),
            contact_state=None,
            hold=_hold(segment, scene),
            attached=_attached(segment),
            body_poses={name: to_pose7s(transforms) for name, transforms in poses.items()},
            contacts=list(_contacts(segment, places, scene)),
            reserve=_reserve(segment),
        )
        begin = stated.end
        places |= {name: transforms[-1] for name, transforms in poses.items()}
        yield stated


def least_reserve(segments: Sequence[ToolSegment]) -> LeastReserve | None:
    """Return where least of the limits is left along a plan; None where nothing is held."""
    held = [(index, each.reserve) for index, each in enumerate(segments) if each.reserve is not None]
    if not held:
        return None
    index, least = min(held, key=lambda each: each[1].least)
    value = float(significant(np.array(least.least)))
    return LeastReserve(value=value, limited_by=least.limited_by, body=least.body, segment=index, sample=least.sample)


def _hold(segment: ToolSegment, scene: SuctionToolScene) -> Hold | None:
    if not segment.holds:
        return None
    grips = [_grip(hold, scene.squeeze) for hold in segment.holds]
    return Hold(grip=grips[0], push=None, second_grip=grips[1] if len(grips) > 1 else None)


def _grip(hold: ToolHold, squeeze: float) -> Grip:
    pose = pose_row(hold.T_tool_tcp)
    return Grip(arm=hold.arm, body=TOOL_NAME, pose=pose, width=hold.width, squeeze=squeeze)


def _reserve(segment: ToolSegment) -> Array:
    if segment.reserve is None:
        return np.full(len(segment.trajectory.time), np.nan)
    return significant(segment.reserve.values)


def _attached(segment: ToolSegment) -> dict[str, list[Attachment]]:
    """Attach the tool while no fingers act on it, and the object while no vacuum goes on or off."""
    attached: dict[str, list[Attachment]] = {}
    if segment.holds and segment.kind not in (SegmentKind.GRIP, SegmentKind.RELEASE):
        attached[TOOL_NAME] = [Attachment(to=hold.arm, pose=pose_row(hold.T_flange_tool)) for hold in segment.holds]
    sucked = segment.sucked
    if sucked is not None and segment.kind not in (SegmentKind.ATTACH, SegmentKind.DETACH):
        attached[sucked.name] = [Attachment(to=TOOL_NAME, pose=pose_row(sucked.T_tool_object))]
    return attached


def _contacts(segment: ToolSegment, places: Mapping[str, Array], scene: SuctionToolScene) -> Iterator[Contact]:
    """Yield all contacts of a segment; their numbers are rounded all at once, as there are thousands."""
    stated = [(each, force) for each in segment.contact_sets for force in each.forces]
    if not stated:
        return
    points, normals, wrenches = (
        significant(np.array(rows))
        for rows in zip(*((force.point, force.normal, force.wrench) for _, force in stated), strict=True)
    )
    of_cup = [entry for entry in stated if entry[1].kind == "suction"]
    cup, pulls = scene.tool.cup, _cup_pulls(of_cup, segment, places)
    for (contact_set, force), point, normal, wrench in zip(stated, points, normals, wrenches, strict=True):
        where = {"sample": contact_set.sample, "body": contact_set.body}
        if force.kind == "inertia":
            yield InertiaEntry(**where, by=None, finger=None, kind="inertia", point=point, normal=None, wrench=wrench)
            continue
        common: dict[str, Any] = {
            **where, "by": force.by, "finger": force.finger, "point": point, "normal": normal, "wrench": wrench
        }  # fmt: skip
        match force.kind:
            case "suction":
                pull, axis = next(pulls)
                yield SuctionContact(
                    **common, kind="suction", mu=cup.mu, radius=cup.radius, kappa=cup.kappa, limit=cup.max_force,
                    suction_force=pull, x_axis=axis,
                )  # fmt: skip
            case "soft_finger":
                limit, mu = scene.finger_limit(force.by), scene.friction.grip
                yield SoftFingerContact(
                    **common, kind="soft_finger", mu=mu, eps=scene.friction.eps, limit=limit, squeeze=scene.squeeze
                )
            case "environment":
                yield EnvironmentContact(**common, kind="environment", mu=scene.friction.environment, limit=None)
            case _:
                raise AssertionError(force.kind)


def _cup_pulls(
    stated: Sequence[tuple[ToolContactSet, ExertedForce]], segment: ToolSegment, places: Mapping[str, Array]
) -> Iterator[tuple[float, Array]]:
    """Yield how hard the cup pulls in each of its contacts [N], and the x axis (3,) of its pad there."""
    if not stated:
        return
    moving = segment.body_poses
    normals = np.array([force.normal for _, force in stated])
    forces = np.array([force.wrench[:3] for _, force in stated])
    T_world_bodies = np.array(
        [moving[each.body][each.sample] if each.body in moving else places[each.body] for each, _ in stated]
    )
    pulls = significant(-np.einsum("ij,ij->i", forces, normals)).tolist()
    axes = significant(pad_axes(T_world_bodies, normals))
    yield from zip(pulls, axes, strict=True)
