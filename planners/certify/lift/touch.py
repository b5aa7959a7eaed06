"""What touches a lifted plate: where its contacts are, what is attached to it, and which solids may touch."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from planners.certify.common.attachments import drift_checks, resting_check
from planners.certify.common.cones import x_axis_error
from planners.certify.common.contact_places import ContactPlaceChecks, Maker
from planners.certify.finding import Finding
from planners.certify.lift.contact_states import support_height
from planners.certify.lift.task import LiftTask
from planners.certify.motion.collision import TouchRule, holds_around
from planners.certify.motion.segment_motion import BodyContacts, SegmentMotion
from planners.certify.motion.solids import ConvexSolid
from planners.certify.plan_view import ContactView, PlanView, SegmentView
from planners.certify.settings import CertifySettings
from planners.plan.scenery import ARMS
from planners.plan.verdicts import Check


class LiftContactPlaces(ContactPlaceChecks):
    """Contacts of a plate with two hands, its support and the cup."""

    def __init__(self, plan: PlanView, task: LiftTask, settings: CertifySettings) -> None:
        super().__init__(plan, settings)
        self._task = task

    def _makers(self) -> Mapping[str, Maker]:
        return {
            "soft_finger": self._finger,
            "point": self._tip,
            "environment": self._environment,
            "suction": self._pad,
        }

    def _tip(self, motion: SegmentMotion, contact_set: BodyContacts, contact: ContactView, where: str) -> None:
        hand = self._plan.hands.get(contact.by)
        if hand is None or hand.T_flange_tip is None:
            self._points.require(False, where, "has no tip")
            return
        T_world_flange = motion.frames[contact.by][contact.sample, 6]
        tip = T_world_flange[:3, :3] @ hand.T_flange_tip[:3, 3] + T_world_flange[:3, 3]
        self._meets(contact, tip + hand.tip_radius * contact.normal, contact.normal, f"{where}: at the tip")

    def _environment(self, motion: SegmentMotion, contact_set: BodyContacts, contact: ContactView, where: str) -> None:
        if contact.by != self._plan.support:
            self._points.require(False, where, f"{contact.body} rests on {self._plan.support}")
            return
        above = float(contact.point[2]) - support_height(self._plan)
        self._points.note(self._settings.contact_distance - abs(above), f"{where}: height of {contact.by}")
        pose = motion.body_poses[contact.by][contact.sample]
        self._on_surface(
            self._plan.bodies[contact.by].shape, pose, contact.point, contact.normal, f"{where}: on {contact.by}"
        )

    def _pad(self, motion: SegmentMotion, contact_set: BodyContacts, contact: ContactView, where: str) -> None:
        if contact.by != "cup" or contact.body != "plate":
            self._points.require(False, where, "only the cup sucks, and only at the plate")
            return
        T = contact_set.T_world_body
        top = float(self._plan.bodies["plate"].shape.vertices[:, 2].max())
        point = T[:3, :3] @ np.append(self._task.cup.position, top) + T[:3, 3]
        self._meets(contact, point, -T[:3, 2], f"{where}: at the cup")
        error = x_axis_error(contact, T)
        self._normals.note(self._settings.contact_angle - error, f"{where}: x axis")


class LiftTouchRule(TouchRule):
    """Pads and fingers may touch a held body, the tip a pushed one, the plate its support, the cup the plate."""

    def __init__(self, plan: PlanView, segment: SegmentView) -> None:
        self._support = plan.support
        around = holds_around(plan, segment)
        self._held = {(grip.arm, grip.body) for s in around for grip in s.grips}
        self._pushed = {(s.push.arm, s.push.body) for s in around if s.push is not None}

    def _hand(self, part: ConvexSolid, body: ConvexSolid) -> bool:
        key = (part.frame.owner, body.frame.owner)
        if part.group in ("pad", "finger"):
            return key in self._held
        return part.group == "tip" and key in self._pushed

    def _bodies(self, a: ConvexSolid, b: ConvexSolid) -> bool:
        return self._rests(a, b) or self._rests(b, a) or {a.group, b.group} == {"cup", "plate"}

    def _rests(self, a: ConvexSolid, b: ConvexSolid) -> bool:
        return a.group == "plate" and b.frame.owner == self._support


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
