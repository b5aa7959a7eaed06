"""What the lift's hands attach, and the lifter: cup and cable stay with the plate."""

from __future__ import annotations

import numpy as np

from planners.certify.attachments import drift_checks, resting_check
from planners.certify.finding import Finding
from planners.certify.motion import SegmentMotion
from planners.certify.plan_view import PlanView, SegmentView
from planners.certify.settings import CertifySettings
from planners.plan.scenery import ARMS
from planners.plan.verdicts import Check


def lift_attachment_checks(plan: PlanView, motions: list[SegmentMotion], settings: CertifySettings) -> list[Check]:
    """Check drift and turn of attached bodies, who may attach what, cup and cable, and bodies at rest."""
    return [
        *drift_checks(motions, settings),
        _rules(plan, motions),
        _lifter(plan, motions, settings),
        resting_check(plan, motions, _carried, settings),
    ]


def _rules(plan: PlanView, motions: list[SegmentMotion]) -> Check:
    finding = Finding("attachment_rules", "1")
    for motion in motions:
        segment = motion.segment
        for attachment in segment.attached:
            stick = attachment.to in ARMS and plan.hands[attachment.to].kind == "stick"
            finding.require(not stick, segment.place(), f"{attachment.body} is attached to a stick")
        if segment.grip is None:
            continue
        arms = {a.to for a in segment.attached if a.body == segment.grip.body}
        if segment.kind in ("grip", "release"):
            wrong = segment.grip.arm in arms
            text = f"{segment.grip.body} is attached while the {segment.grip.arm} hand opens or closes"
        else:
            wrong = segment.grip.arm not in arms
            text = f"{segment.grip.body} is held by the {segment.grip.arm} hand and not attached to it"
        finding.require(not wrong, segment.place(), text)
    return finding.check()


def _carried(segment: SegmentView) -> set[str]:
    free = {attachment.body for attachment in segment.attached}
    if segment.kind not in ("grip", "release"):
        free |= {hold.body for hold in (segment.grip, segment.push) if hold is not None}
    if "plate" in free:
        free |= {"cup", "cable"}
    return free


def _lifter(plan: PlanView, motions: list[SegmentMotion], settings: CertifySettings) -> Check:
    """The cup keeps its pose on the plate; the cable keeps its foot on the cup and hangs plumb."""
    finding = Finding("lifter", "m")
    if not {"plate", "cup", "cable"} <= set(plan.bodies):
        return finding.check()
    start = {name: plan.bodies[name].T_world_start for name in ("plate", "cup", "cable")}
    T_plate_cup = np.linalg.inv(start["plate"]) @ start["cup"]
    rim = plan.bodies["cup"].shape.vertices
    axis = plan.bodies["cable"].shape.vertices[:, 2]
    foot, top = (np.array([0.0, 0.0, axis.min(), 1.0]), np.array([0.0, 0.0, axis.max(), 1.0]))
    anchor = np.linalg.inv(start["cup"]) @ start["cable"] @ foot
    for motion in motions:
        plate, cup, cable = (motion.body_poses[name] for name in ("plate", "cup", "cable"))
        seat = plate @ T_plate_cup
        shift = np.linalg.norm(
            np.einsum("nij,kj->nki", (cup - seat)[:, :3, :3], rim) + (cup - seat)[:, None, :3, 3], axis=2
        ).max(axis=1)
        finding.note_all(
            settings.attachment_distance - shift, lambda i, m=motion: f"{m.segment.place(i)}: the cup leaves the plate"
        )
        gap = np.linalg.norm((cable @ foot - cup @ anchor)[:, :3], axis=1)
        finding.note_all(
            settings.attachment_distance - gap, lambda i, m=motion: f"{m.segment.place(i)}: the cable leaves the cup"
        )
        lean = np.linalg.norm((cable @ top - cable @ foot)[:, :2], axis=1)
        upright = np.where((cable @ top - cable @ foot)[:, 2] > 0, lean, np.inf)
        finding.note_all(
            settings.contact_distance - upright, lambda i, m=motion: f"{m.segment.place(i)}: the cable leans"
        )
    return finding.check()
