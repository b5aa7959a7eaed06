"""What touches a lifted plate: where its contacts are, what is attached to it, and which solids may touch."""

from __future__ import annotations

import numpy as np

from planners.certify.common.cones import x_axis_error
from planners.certify.common.contact_places import ContactPlaceChecks
from planners.certify.common.holds import drift_checks, resting_check
from planners.certify.evidence import Evidence
from planners.certify.finding import Finding
from planners.certify.lift.contact_states import support_height
from planners.certify.motion.collision import TouchRule, holds_around
from planners.certify.motion.segment_motion import BodyContacts, SegmentMotion
from planners.certify.plan_view import NumberedSegment, PlanView
from planners.plan.contacts import EnvironmentContact, PointContact, SuctionContact
from planners.plan.verdicts import Check


class LiftContactPlaces(ContactPlaceChecks):
    """Contacts of a plate with two hands, its support and the cup."""

    def __init__(self, evidence: Evidence, cup_position: tuple[float, float]) -> None:
        super().__init__(evidence)
        self._cup_position = cup_position

    def _tip(self, motion: SegmentMotion, contact: PointContact, where: str) -> None:
        stick = self._plan.sticks.get(contact.by)
        if stick is None:
            self._points.require(False, where, "has no tip")
            return
        T_world_flange = motion.frames[contact.by][contact.sample, 6]
        tip = T_world_flange[:3, :3] @ stick.T_flange_tip[:3, 3] + T_world_flange[:3, 3]
        self._meets(contact, tip + stick.tip_radius * contact.normal, contact.normal, f"{where}: at the tip")

    def _carrier(self, motion: SegmentMotion, contact: EnvironmentContact, where: str) -> None:
        if contact.by != self._plan.support:
            self._points.require(False, where, f"{contact.body} rests on {self._plan.support}")
            return
        above = float(contact.point[2]) - support_height(self._plan)
        self._points.note(self._settings.contact_distance - abs(above), f"{where}: height of {contact.by}")
        self._on_carrier(motion, contact, where)

    def _cup(self, motion: SegmentMotion, contact_set: BodyContacts, contact: SuctionContact, where: str) -> None:
        if contact.by != "cup" or contact.body != "plate":
            self._points.require(False, where, "only the cup sucks, and only at the plate")
            return
        T = contact_set.T_world_body
        top = float(self._plan.plate.shape.vertices[:, 2].max())
        point = T[:3, :3] @ np.append(self._cup_position, top) + T[:3, 3]
        self._meets(contact, point, -T[:3, 2], f"{where}: at the cup")
        error = x_axis_error(contact, T)
        self._normals.note(self._settings.contact_angle - error, f"{where}: x axis")


def lift_touch_rule(plan: PlanView, segment: NumberedSegment) -> TouchRule:
    """Pads and fingers may touch a held body, the tip a pushed one, the plate its support, the cup the plate."""
    around = holds_around(plan, segment)
    return TouchRule(
        gripped={(grip.arm, grip.body) for each in around for grip in each.grips},
        pushed={(each.push.arm, each.push.body) for each in around if each.push is not None},
        bodies={frozenset({"plate", plan.support}), frozenset({"cup", "plate"})},
    )


def lift_attachment_checks(evidence: Evidence) -> list[Check]:
    """Check drift and turn of attached bodies, who may attach what, cup and cable, and bodies at rest."""
    finding = Finding("attachment_rules", "1")
    for segment in evidence.plan.segments:
        _rules(evidence.plan, segment, finding)
    return [*drift_checks(evidence), finding.check(), _lifter(evidence), resting_check(evidence, _carried)]


def _rules(plan: PlanView, segment: NumberedSegment, finding: Finding) -> None:
    for body, ride in segment.rides:
        finding.require(ride.to not in plan.sticks, segment.place(), f"{body} is attached to a stick")
    if segment.grip is None:
        return
    body, arm = segment.grip.body, segment.grip.arm
    attached = any(name == body and ride.to == arm for name, ride in segment.rides)
    if segment.kind in ("grip", "release"):
        text = f"{body} is attached while the {arm} hand opens or closes"
        finding.require(not attached, segment.place(), text)
    else:
        text = f"{body} is held by the {arm} hand and not attached to it"
        finding.require(attached, segment.place(), text)


def _carried(segment: NumberedSegment) -> set[str]:
    free = {body for body, _ in segment.rides}
    if segment.kind not in ("grip", "release"):
        free |= {hold.body for hold in (segment.grip, segment.push) if hold is not None}
    if "plate" in free:
        free |= {"cup", "cable"}
    return free


def _lifter(evidence: Evidence) -> Check:
    """The cup keeps its pose on the plate; the cable keeps its foot on the cup and hangs plumb."""
    plan, settings, finding = evidence.plan, evidence.settings, Finding("lifter", "m")
    if not {"plate", "cup", "cable"} <= set(plan.bodies):
        return finding.check()
    plate_body, cup_body, cable_body = (plan.bodies[name] for name in ("plate", "cup", "cable"))
    T_plate_cup = np.linalg.inv(plate_body.T_world_start) @ cup_body.T_world_start
    rim = cup_body.shape.vertices
    axis = cable_body.shape.vertices[:, 2]
    foot, top = (np.array([0.0, 0.0, axis.min(), 1.0]), np.array([0.0, 0.0, axis.max(), 1.0]))
    anchor = np.linalg.inv(cup_body.T_world_start) @ cable_body.T_world_start @ foot
    for motion in evidence.motions:
        segment = motion.segment
        plate, cup, cable = (motion.body_poses[name] for name in ("plate", "cup", "cable"))
        off = cup - plate @ T_plate_cup
        shift = np.linalg.norm(np.einsum("nij,kj->nki", off[:, :3, :3], rim) + off[:, None, :3, 3], axis=2).max(axis=1)
        finding.note_samples(segment, settings.attachment_distance - shift, "the cup leaves the plate")
        gap = np.linalg.norm((cable @ foot - cup @ anchor)[:, :3], axis=1)
        finding.note_samples(segment, settings.attachment_distance - gap, "the cable leaves the cup")
        along = cable @ top - cable @ foot
        lean = np.where(along[:, 2] > 0, np.linalg.norm(along[:, :2], axis=1), np.inf)
        finding.note_samples(segment, settings.contact_distance - lean, "the cable leans")
    return finding.check()
