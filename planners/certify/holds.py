"""Hands are where their holds say: pads on the gripped body, the stick's tip on the pushed one."""

from __future__ import annotations

import numpy as np

from planners.certify.attachments import rotation_angles
from planners.certify.body_shape import BodyShape
from planners.certify.finding import Finding
from planners.certify.lines import stretches_inside
from planners.certify.motion import SegmentMotion, relative
from planners.certify.plan_view import PlanView, SegmentView
from planners.certify.settings import CertifySettings
from planners.geometry.pose import Array, Transform
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
