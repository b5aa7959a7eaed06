"""Hands hold as their holds say: pads on the gripped body, the stick's tip on the pushed one, squeezed as commanded.

A parallel gripper commands a squeeze: each pad presses with it while nothing else acts, and a load along the closing
axis adds half of itself to one pad and takes it from the other. So the normal forces of both fingers add up to twice
the squeeze.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from planners.certify.common.attachments import rotation_angles
from planners.certify.finding import Finding
from planners.certify.geometry.body_shape import BodyShape
from planners.certify.geometry.triangle_surface import stretches_inside
from planners.certify.motion.segment_motion import BodyContacts, SegmentMotion, relative
from planners.certify.plan_view import PlanView, SegmentView
from planners.certify.settings import CertifySettings
from planners.geometry.pose import Array, Transform
from planners.plan.scenery import ARMS
from planners.plan.segment import Grip, Push
from planners.plan.verdicts import Check


def hold_checks(plan: PlanView, motions: list[SegmentMotion], settings: CertifySettings) -> list[Check]:
    """Check grips (pose, opening) and pushes (the tip stays on its point)."""
    place, turn = Finding("grips", "m"), Finding("grip_angles", "rad")
    width, push = Finding("grip_width", "m"), Finding("pushes", "m")
    for motion in motions:
        for grip in motion.segment.grips:
            _grip(plan, motion, grip, settings, (place, turn, width))
        if motion.segment.push is not None:
            _push(plan, motion, motion.segment.push, settings, push)
    return [finding.check() for finding in (place, turn, width, push)]


def held_samples(segment: SegmentView, arm: str, ends: tuple[str, str]) -> slice:
    """Return the samples in which a hold stands: only the last while it is being taken, the first while it is left."""
    taking, leaving = ends
    if segment.kind == taking and (arm in segment.movers or taking == "grip"):
        return slice(-1, None)
    if segment.kind == leaving and (arm in segment.movers or leaving == "release"):
        return slice(0, 1)
    return slice(None)


def _grip(
    plan: PlanView,
    motion: SegmentMotion,
    grip: Grip,
    settings: CertifySettings,
    findings: tuple[Finding, Finding, Finding],
) -> None:
    segment = motion.segment
    place, turn, width = findings
    acting = grip is segment.grip
    chosen = held_samples(segment, grip.arm, ("grip", "release")) if acting else slice(None)
    samples = np.arange(len(segment.time))[chosen]
    widths = segment.widths[grip.arm]
    tcp = motion.frames[grip.arm][:, 6] @ plan.hands[grip.arm].T_flange_tcp(widths)
    poses = relative(motion.body_poses[grip.body], tcp)[chosen]

    def where(i: int) -> str:
        return f"{segment.place(int(samples[i]))}: {grip.arm} hand on {grip.body}"

    place.note_all(
        settings.attachment_distance - np.linalg.norm(poses[:, :3, 3] - grip.T_body_tcp[:3, 3], axis=1), where
    )
    turn.note_all(settings.attachment_angle - rotation_angles(poses, grip.T_body_tcp), where)
    thickness, offset = _thickness(plan.bodies[grip.body].shape, grip.T_body_tcp, settings.seam)
    width.note_all(settings.contact_distance - np.abs(widths[chosen] - thickness), where)
    width.note(settings.contact_distance - abs(grip.width - thickness), f"{segment.place()}: width of the hold")
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


def _push(plan: PlanView, motion: SegmentMotion, push: Push, settings: CertifySettings, finding: Finding) -> None:
    segment = motion.segment
    chosen = held_samples(segment, push.arm, ("approach", "retreat"))
    samples = np.arange(len(segment.time))[chosen]
    distance = push_errors(plan, motion, push)[chosen]
    finding.note_all(
        settings.contact_distance - distance,
        lambda i: f"{segment.place(int(samples[i]))}: {push.arm} tip on {push.body}",
    )
    height, _ = plan.bodies[push.body].shape.surface_distance(push.point)
    finding.note(settings.contact_distance - abs(height), f"{segment.place()}: point of the push on {push.body}")


def push_errors(plan: PlanView, motion: SegmentMotion, push: Push) -> Array:
    """Return the distances between the tip's contact point and the hold's point on the body: (n,) [m]."""
    hand = plan.hands[push.arm]
    assert hand.T_flange_tip is not None
    body = motion.body_poses[push.body]
    flange = motion.frames[push.arm][:, 6]
    tip = flange[:, :3, :3] @ hand.T_flange_tip[:3, 3] + flange[:, :3, 3]
    normal = body[:, :3, :3] @ push.normal
    point = body[:, :3, :3] @ push.point + body[:, :3, 3]
    return np.linalg.norm(tip + hand.tip_radius * normal - point, axis=1)


def squeeze_check(
    plan: PlanView, sets: Sequence[BodyContacts], settings: CertifySettings, *, required: bool = True
) -> Check:
    """Check the squeezes of all grips, and that the contacts of their fingers are those of a squeeze.

    Args:
        plan: the document.
        sets: all contact sets.
        settings: tolerances.
        required: whether every grip has to state its squeeze; else those are passed over that do not.
    """
    finding = Finding("squeeze", "N")
    _range(plan, finding, settings, required=required)
    _constancy(plan, finding, settings)
    for contact_set in sets:
        _contacts(contact_set, finding, settings, required=required)
    return finding.check()


def _range(plan: PlanView, finding: Finding, settings: CertifySettings, *, required: bool) -> None:
    for segment in plan.segments:
        for grip in segment.grips:
            where = f"{segment.place()}: {grip.arm} hand"
            force_range = plan.hands[grip.arm].force_range
            if grip.squeeze is None:
                if required:
                    finding.require(False, where, "no squeeze is stated")
            elif force_range is None:
                finding.require(False, where, "nothing is known of how hard its gripper squeezes")
            else:
                least, most = force_range
                finding.note(min(grip.squeeze - least, most - grip.squeeze) + settings.cone_slack, where)


def _constancy(plan: PlanView, finding: Finding, settings: CertifySettings) -> None:
    """A hold lasts from segment to segment for as long as its hand has a grip of its body, up to a release."""
    held: dict[str, Grip] = {}
    for segment in plan.segments:
        grips = {grip.arm: grip for grip in segment.grips}
        for arm, grip in grips.items():
            before = held.get(arm)
            if before is not None and before.body == grip.body and grip.squeeze != before.squeeze:
                change = abs((grip.squeeze or 0.0) - (before.squeeze or 0.0))
                finding.note(settings.cone_slack - change, f"{segment.place()}: {arm} hand, not as before")
        held = {arm: grip for arm, grip in grips.items() if not _lets_go(segment, grip)}


def _lets_go(segment: SegmentView, grip: Grip) -> bool:
    return segment.kind == "release" and grip is segment.grip


def _contacts(contact_set: BodyContacts, finding: Finding, settings: CertifySettings, *, required: bool) -> None:
    commanded = {grip.arm: grip.squeeze for grip in contact_set.segment.grips}
    for arm in ARMS:
        fingers = [c for c in contact_set.contacts if c.by == arm and c.kind == "soft_finger"]
        if not fingers:
            continue
        where, squeeze = f"{contact_set.where} by {arm}", commanded.get(arm)
        if squeeze is None:
            if required:
                finding.require(False, where, "no squeeze is commanded")
            continue
        for finger in fingers:
            stated = finger.squeeze
            if stated is None:
                finding.require(False, f"{where} finger {finger.finger}", "states no squeeze")
            else:
                finding.note(settings.cone_slack - abs(stated - squeeze), f"{where} finger {finger.finger}: squeeze")
        pressed = sum(float(finger.force @ finger.normal) for finger in fingers)
        finding.note(settings.cone_slack - abs(pressed - 2.0 * squeeze), f"{where}: both fingers together")
