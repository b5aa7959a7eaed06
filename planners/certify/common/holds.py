"""Bodies are held as it is said: pads and tip on them, squeezed as commanded, and they stay where they are attached.

A parallel gripper commands a squeeze: each pad presses with it while nothing else acts, and a load along the closing
axis adds half of itself to one pad and takes it from the other. So the normal forces of both fingers add up to twice
the squeeze.
"""

from __future__ import annotations

from collections.abc import Callable, Set

import numpy as np

from planners.certify.evidence import Evidence
from planners.certify.finding import Finding
from planners.certify.geometry.body_shape import BodyShape
from planners.certify.geometry.triangle_surface import stretches_inside
from planners.certify.motion.segment_motion import BodyContacts, SegmentMotion, relative, rotation_angles
from planners.certify.plan_view import NumberedSegment, PlanView, T_flange_tcp
from planners.certify.settings import CertifySettings
from planners.geometry.pose import Transform
from planners.plan.scenery import ARMS
from planners.plan.segment import Grip, Push
from planners.plan.verdicts import Check


def hold_checks(evidence: Evidence) -> list[Check]:
    """Check grips (pose, opening) and pushes (the tip stays on its point)."""
    place, turn = Finding("grips", "m"), Finding("grip_angles", "rad")
    width, push = Finding("grip_width", "m"), Finding("pushes", "m")
    for motion in evidence.motions:
        for grip in motion.segment.grips:
            _grip(evidence, motion, grip, place, turn, width)
        if motion.segment.push is not None:
            _push(evidence, motion, motion.segment.push, push)
    _same_all_along(evidence, place, turn)
    return [finding.check() for finding in (place, turn, width, push)]


def _same_all_along(evidence: Evidence, place: Finding, turn: Finding) -> None:
    """A hold states what it stated first, up to its release: else a body could creep within what segments forgive."""
    first: dict[tuple[str, str], Grip] = {}
    for segment in evidence.plan.segments:
        let_go, held = segment.grip if segment.kind == "release" else None, dict[tuple[str, str], Grip]()
        for grip in segment.grips:
            began = first.get((grip.arm, grip.body), grip)
            where = f"{segment.place()}: {grip.arm} hand on {grip.body}, not as before"
            _unchanged(grip.T_body_tcp, began.T_body_tcp, where, place, turn, evidence.settings)
            if grip is not let_go:
                held[grip.arm, grip.body] = began
        first = held


def _unchanged(
    T: Transform, T_first: Transform, where: str, place: Finding, turn: Finding, settings: CertifySettings
) -> None:
    place.note(settings.attachment_distance - float(np.linalg.norm(T[:3, 3] - T_first[:3, 3])), where)
    turn.note(settings.attachment_angle - float(rotation_angles(T[None], T_first)[0]), where)


def _held_samples(segment: NumberedSegment, arm: str, taking: str, leaving: str) -> slice:
    """Return the samples in which a hold stands: only the last while it is being taken, the first while it is left."""
    if segment.kind == taking and (arm in segment.movers or taking == "grip"):
        return slice(len(segment.time) - 1, None)
    if segment.kind == leaving and (arm in segment.movers or leaving == "release"):
        return slice(0, 1)
    return slice(0, None)


def _grip(evidence: Evidence, motion: SegmentMotion, grip: Grip, place: Finding, turn: Finding, width: Finding) -> None:
    plan, settings, segment = evidence.plan, evidence.settings, motion.segment
    acting = grip is segment.grip
    chosen = _held_samples(segment, grip.arm, "grip", "release") if acting else slice(0, None)
    widths = segment.gripper_width[grip.arm]
    tcp = motion.frames[grip.arm][:, 6] @ T_flange_tcp(plan.grippers[grip.arm], widths)
    poses = relative(motion.body_poses[grip.body], tcp)[chosen]
    apart = np.linalg.norm(poses[:, :3, 3] - grip.T_body_tcp[:3, 3], axis=1)
    turned = rotation_angles(poses, grip.T_body_tcp)
    thickness, offset = _thickness(plan.bodies[grip.body].shape, grip.T_body_tcp, settings.seam)
    off, name = np.abs(widths[chosen] - thickness), f"{grip.arm} hand on {grip.body}"
    place.note_samples(segment, settings.attachment_distance - apart, name, first=chosen.start)
    turn.note_samples(segment, settings.attachment_angle - turned, name, first=chosen.start)
    width.note_samples(segment, settings.contact_distance - off, name, first=chosen.start)
    width.note(settings.contact_distance - abs(grip.width - thickness), f"{segment.place()}: width of the hold")
    if acting and segment.kind in ("grip", "release"):
        # Nothing else says that the pads were off before, or are now: they may touch what they come to and leave.
        free = 0 if segment.kind == "grip" else motion.samples - 1
        room = float(widths[free]) - thickness - settings.contact_distance
        width.note(room, f"{segment.place(free)}: the {grip.arm} hand is not open")
    width.note(settings.contact_distance - abs(offset), f"{segment.place()}: the pads do not meet {grip.body} together")


def _thickness(shape: BodyShape, T_body_tcp: Transform, seam: float) -> tuple[float, float]:
    """Return how thick a body is along the pads' line, and how far its middle is from the TCP [m].

    Where the line is inside more than once, of the stretch about the TCP or nearest to it; 0 where it misses the body.
    """
    stretches = stretches_inside(shape.triangles, T_body_tcp[:3, 3], T_body_tcp[:3, 1], seam)
    if len(stretches) == 0:
        return 0.0, 0.0
    begin, end = stretches[np.argmin(np.maximum(stretches[:, 0], -stretches[:, 1]))]
    return float(end - begin), float(end + begin) / 2


def _push(evidence: Evidence, motion: SegmentMotion, push: Push, finding: Finding) -> None:
    plan, allowed, segment = evidence.plan, evidence.settings.contact_distance, motion.segment
    chosen = _held_samples(segment, push.arm, "approach", "retreat")
    stick, body, flange = plan.sticks[push.arm], motion.body_poses[push.body], motion.frames[push.arm][:, 6]
    tip = flange[:, :3, :3] @ stick.T_flange_tip[:3, 3] + flange[:, :3, 3]
    normal = body[:, :3, :3] @ push.normal
    point = body[:, :3, :3] @ push.point + body[:, :3, 3]
    apart = np.linalg.norm(tip + stick.tip_radius * normal - point, axis=1)[chosen]
    finding.note_samples(segment, allowed - apart, f"{push.arm} tip on {push.body}", first=chosen.start)
    height, _ = plan.bodies[push.body].shape.surface_distance(push.point)
    finding.note(allowed - abs(height), f"{segment.place()}: point of the push on {push.body}")


def squeeze_check(evidence: Evidence, *, required: bool = True) -> Check:
    """Check the squeezes of all grips: in their range, all along a hold, and in the contacts of both fingers together.

    Args:
        evidence: of the document.
        required: whether every grip has to state its squeeze; else those are passed over that do not.
    """
    finding, slack = Finding("squeeze", "N"), evidence.settings.cone_slack
    _range(evidence.plan, finding, slack, required=required)
    _constancy(evidence.plan, finding, slack)
    for contact_set in evidence.contacts:
        _fingers(contact_set, finding, slack, required=required)
    return finding.check()


def _range(plan: PlanView, finding: Finding, slack: float, *, required: bool) -> None:
    for segment in plan.segments:
        for grip in segment.grips:
            where = f"{segment.place()}: {grip.arm} hand"
            force_range = plan.grippers[grip.arm].force_range
            if grip.squeeze is None:
                if required:
                    finding.require(False, where, "no squeeze is stated")
            elif force_range is None:
                finding.require(False, where, "nothing is known of how hard its gripper squeezes")
            else:
                least, most = force_range
                finding.note(min(grip.squeeze - least, most - grip.squeeze) + slack, where)


def _constancy(plan: PlanView, finding: Finding, slack: float) -> None:
    """A hold lasts from segment to segment for as long as its hand has a grip of its body, up to a release."""
    held: dict[str, Grip] = {}
    for segment in plan.segments:
        for grip in segment.grips:
            before = held.get(grip.arm)
            if before is not None and before.body == grip.body and grip.squeeze != before.squeeze:
                change = abs((grip.squeeze or 0.0) - (before.squeeze or 0.0))
                finding.note(slack - change, f"{segment.place()}: {grip.arm} hand, not as before")
        let_go = segment.grip if segment.kind == "release" else None
        held = {grip.arm: grip for grip in segment.grips if grip is not let_go}


def _fingers(contact_set: BodyContacts, finding: Finding, slack: float, *, required: bool) -> None:
    commanded = {grip.arm: grip.squeeze for grip in contact_set.segment.grips}
    for arm in ARMS:
        fingers = [c for c in contact_set.bearing if c.by == arm and c.kind == "soft_finger"]
        if not fingers:
            continue
        where, squeeze = f"{contact_set.where} by {arm}", commanded.get(arm)
        if squeeze is None:
            if required:
                finding.require(False, where, "no squeeze is commanded")
            continue
        for finger in fingers:
            if finger.squeeze is None:
                finding.require(False, f"{where} finger {finger.finger}", "states no squeeze")
            else:
                finding.note(slack - abs(finger.squeeze - squeeze), f"{where} finger {finger.finger}: squeeze")
        pressed = sum(float(finger.force @ finger.normal) for finger in fingers)
        finding.note(slack - abs(pressed - 2.0 * squeeze), f"{where}: both fingers together")


def drift_checks(evidence: Evidence) -> list[Check]:
    """Check drift and turn of attached bodies, in a segment and from one to the next that they are attached in."""
    place, turn, settings = Finding("attachments", "m"), Finding("attachment_angles", "rad"), evidence.settings
    first: dict[tuple[str, str], Transform] = {}
    for motion in evidence.motions:
        attached: dict[tuple[str, str], Transform] = {}
        for body, ride in motion.segment.rides:
            holder = motion.frames[ride.to][:, 6] if ride.to in ARMS else motion.body_poses[ride.to]
            poses = relative(holder, motion.body_poses[body])
            distance = np.linalg.norm(poses[:, :3, 3] - ride.T_to_body[:3, 3], axis=1)
            text, turned = f"{body} on {ride.to}", rotation_angles(poses, ride.T_to_body)
            place.note_samples(motion.segment, settings.attachment_distance - distance, text)
            turn.note_samples(motion.segment, settings.attachment_angle - turned, text)
            began = attached[body, ride.to] = first.get((body, ride.to), ride.T_to_body)
            where = f"{motion.segment.place()}: {text}, not as before"
            _unchanged(ride.T_to_body, began, where, place, turn, settings)
        first = attached
    return [place.check(), turn.check()]


def resting_check(evidence: Evidence, carried: Callable[[NumberedSegment], Set[str]]) -> Check:
    """Check that bodies move only where they are carried; `carried` names those of a segment."""
    finding = Finding("resting_bodies", "m")
    for segment in evidence.plan.segments:
        free = carried(segment)
        for name, poses in segment.transforms.items():
            if name not in free:
                moved = np.abs(poses - poses[0]).max(axis=(1, 2))
                finding.note_samples(segment, evidence.settings.join - moved, f"{name} moves, held by nothing")
            if evidence.plan.bodies[name].static:
                finding.require(False, segment.place(), f"{name} is static and has poses")
    return finding.check()
