"""What touches tool and objects: where their contacts are, what is attached to what, and which solids may touch."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from planners.certify.common.attachments import drift_checks, resting_check
from planners.certify.common.cones import angle, x_axis_error
from planners.certify.common.contact_places import ContactPlaceChecks, Maker
from planners.certify.finding import Finding
from planners.certify.geometry.cover import SealingDisc
from planners.certify.motion.collision import TouchRule, holds_around
from planners.certify.motion.segment_motion import BodyContacts, SegmentMotion
from planners.certify.motion.solids import ConvexSolid
from planners.certify.plan_view import ContactView, PlanView
from planners.certify.settings import CertifySettings
from planners.certify.tool.course import CourseStep, ToolCourse
from planners.certify.tool.task import TOOL
from planners.geometry.pose import Array, frame_from_z, inverse
from planners.plan.verdicts import Check

_RIM = 24
"""Points of the lip's rim whose slant is looked at, and as many half as far out."""


class ToolContactPlaces(ContactPlaceChecks):
    """Contacts of the tool with two hands and an object, and of objects with what carries them."""

    def __init__(self, plan: PlanView, settings: CertifySettings) -> None:
        super().__init__(plan, settings)
        self._sealed: set[tuple[str, bytes]] = set()

    def _makers(self) -> Mapping[str, Maker]:
        return {"soft_finger": self._finger, "environment": self._environment, "suction": self._cup}

    def _slant(self, contact: ContactView) -> float:
        soft = contact.kind in ("soft_finger", "suction")
        return self._settings.pad_slant if soft else self._settings.contact_angle

    def _environment(self, motion: SegmentMotion, contact_set: BodyContacts, contact: ContactView, where: str) -> None:
        if contact.by not in self._plan.bodies or contact.by == contact.body:
            self._points.require(False, where, "is no body that carries another")
            return
        T_world_by = motion.body_poses[contact.by][contact.sample]
        shape = self._plan.bodies[contact.by].shape
        self._on_surface(shape, T_world_by, contact.point, contact.normal, f"{where}: on {contact.by}")

    def _cup(self, motion: SegmentMotion, contact_set: BodyContacts, contact: ContactView, where: str) -> None:
        if TOOL not in (contact.by, contact.body) or contact.by == contact.body:
            self._points.require(False, where, "only the tool sucks")
            return
        T_world_tool = motion.body_poses[TOOL][contact.sample]
        outward = T_world_tool[:3, 2]
        self._meets(contact, T_world_tool[:3, 3], outward if contact.body == TOOL else -outward, f"{where}: at the lip")
        error = x_axis_error(contact, contact_set.T_world_body)
        self._normals.note(self._settings.contact_angle - error, f"{where}: x axis")
        if contact.body != TOOL:
            self._lip(contact, inverse(contact_set.T_world_body) @ T_world_tool, where)

    def _lip(self, contact: ContactView, T_object_tool: Array, where: str) -> None:
        """The whole lip lies on the object; looked at once for each place of the cup."""
        key = contact.body, np.round(T_object_tool, 5).tobytes()
        if key in self._sealed:
            return
        self._sealed.add(key)
        where = f"{where}: the lip on {contact.body}"
        shape, radius = self._plan.bodies[contact.body].shape, contact.radius
        R = frame_from_z(T_object_tool[:3, 2], T_object_tool[:3, 0])
        # The cup may be beside its place by as much as a contact may.
        pad = SealingDisc(radius + self._settings.contact_distance, self._settings.lip_give, self._settings.seam)
        gap = pad.gap((shape.triangles - T_object_tool[:3, 3]) @ R)
        if gap is not None:
            self._points.note(float(np.linalg.norm(gap)) - pad.outer_radius, f"{where}: nothing seals there")
        angles = 2.0 * math.pi * np.arange(_RIM) / _RIM
        for share in (0.5, 1.0):
            circle = share * radius * np.column_stack([np.cos(angles), np.sin(angles)])
            for point in circle @ R[:, :2].T + T_object_tool[:3, 3]:
                normals = shape.normals_near(point, self._settings.lip_give)
                slant = min((angle(R[:, 2], normal) for normal in normals), default=math.pi)
                self._normals.note(self._settings.pad_slant - slant, where)


class ToolTouchRule(TouchRule):
    """Pads and fingers may touch the tool that they hold, the cup its object, bodies at rest what carries them.

    In the motion before the vacuum goes on, and after it went off, the cup comes to the object or leaves it. A body
    that is taken off what carries it, or put down, touches it in the motion after or before.
    """

    def __init__(self, plan: PlanView, course: ToolCourse, index: int) -> None:
        steps, step = course.steps, course.steps[index]
        around = holds_around(plan, step.segment)
        self._held = {(grip.arm, grip.body) for segment in around for grip in segment.grips}
        self._on_cup = set(step.on_cup)
        supports = [step.before.supports, step.after.supports]
        if index + 1 < len(steps) and step.segment.kind == "transfer":
            following = steps[index + 1]
            self._on_cup |= following.on_cup if following.segment.kind == "attach" else set()
            if following.segment.kind in ("detach", "release"):
                supports.append(following.after.supports)
        if index > 0 and step.segment.kind == "transfer":
            self._on_cup |= steps[index - 1].on_cup if steps[index - 1].segment.kind == "detach" else set()
            supports += self._left(steps[index - 1])
        self._rests = {
            frozenset((name, other)) for known in supports for name, below in known.items() for other in below
        }

    @staticmethod
    def _left(before: CourseStep) -> list[Mapping[str, frozenset[str]]]:
        """Return what carried bodies until the segment before this one took them off."""
        return [before.before.supports] if before.segment.kind in ("attach", "grip") else []

    def _hand(self, part: ConvexSolid, body: ConvexSolid) -> bool:
        return part.group in ("pad", "finger") and (part.frame.owner, body.frame.owner) in self._held

    def _bodies(self, a: ConvexSolid, b: ConvexSolid) -> bool:
        names = {a.frame.owner, b.frame.owner}
        if TOOL in names and names & self._on_cup:
            return True
        return frozenset(names) in self._rests


def tool_attachment_checks(
    plan: PlanView, motions: list[SegmentMotion], course: ToolCourse, settings: CertifySettings
) -> list[Check]:
    """Check drift and turn of attached bodies, what may be attached to what, and bodies at rest."""
    finding = Finding("attachment_rules", "1")
    for step in course.steps:
        _rules(step, finding)
    return [
        *drift_checks(motions, settings),
        finding.check(),
        resting_check(plan, motions, lambda segment: {one.body for one in segment.attached}, settings),
    ]


def _rules(step: CourseStep, finding: Finding) -> None:
    segment, where = step.segment, step.segment.place()
    attached = {(one.body, one.to) for one in segment.attached}
    finding.require(len(attached) == len(segment.attached), where, "a body is attached twice to the same")
    hands = {(TOOL, arm) for arm in step.bearers}
    if segment.kind in ("grip", "release"):
        text = "the tool is attached while fingers open or close on it"
        finding.require(not any(body == TOOL for body, _ in attached), where, text)
        hands = set()
    sucked = {(name, TOOL) for name in step.on_cup}
    if segment.kind in ("attach", "detach"):
        attached -= sucked
        sucked = set()
    missing, stray = (hands | sucked) - attached, attached - hands - sucked
    for body, to in sorted(missing):
        finding.require(False, where, f"{body} is held by {to} and not attached to it")
    for body, to in sorted(stray):
        finding.require(False, where, f"{body} is attached to {to}, which does not hold it")
    finding.require(not missing and not stray, where, "attachments are not what is held")
