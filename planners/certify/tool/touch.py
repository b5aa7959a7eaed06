"""What touches tool and objects: where their contacts are, what is attached to what, and which solids may touch."""

from __future__ import annotations

import math

import numpy as np

from planners.certify.common.cones import x_axis_error
from planners.certify.common.contact_places import ContactPlaceChecks
from planners.certify.common.holds import drift_checks, resting_check
from planners.certify.evidence import Evidence
from planners.certify.finding import Finding
from planners.certify.geometry.cover import SealingDisc
from planners.certify.geometry.vectors import angle, length
from planners.certify.motion.collision import TouchRule, holds_around
from planners.certify.motion.segment_motion import BodyContacts, SegmentMotion
from planners.certify.plan_view import PlanView
from planners.certify.tool.task import TOOL
from planners.certify.tool.tool_states import StateChange
from planners.geometry.pose import Array, frame_from_z
from planners.plan.contacts import BearingContact, EnvironmentContact, SuctionContact
from planners.plan.verdicts import Check

_RIM = 24
"""Points of the lip's rim whose slant is looked at, and as many half as far out."""


class ToolContactPlaces(ContactPlaceChecks):
    """Contacts of the tool with two hands and an object, and of objects with what carries them."""

    def __init__(self, evidence: Evidence) -> None:
        super().__init__(evidence)
        self._sealed: set[tuple[str, bytes]] = set()

    def _slant(self, contact: BearingContact) -> float:
        soft = contact.kind in ("soft_finger", "suction")
        return self._settings.pad_slant if soft else self._settings.contact_angle

    def _carrier(self, motion: SegmentMotion, contact: EnvironmentContact, where: str) -> None:
        if contact.by not in self._plan.bodies or contact.by == contact.body:
            self._points.require(False, where, "is no body that carries another")
        else:
            self._on_carrier(motion, contact, where)

    def _cup(self, motion: SegmentMotion, contact_set: BodyContacts, contact: SuctionContact, where: str) -> None:
        if TOOL not in (contact.by, contact.body) or contact.by == contact.body:
            self._points.require(False, where, "only the tool sucks")
            return
        T_world_tool = motion.body_poses[TOOL][contact.sample]
        outward = T_world_tool[:3, 2]
        self._meets(contact, T_world_tool[:3, 3], outward if contact.body == TOOL else -outward, f"{where}: at the lip")
        error = x_axis_error(contact, contact_set.T_world_body)
        self._normals.note(self._settings.contact_angle - error, f"{where}: x axis")
        if contact.body != TOOL:
            self._lip(contact, contact_set.T_body_world @ T_world_tool, where)

    def _lip(self, contact: SuctionContact, T_object_tool: Array, where: str) -> None:
        """The whole lip lies on the object; looked at once for each place of the cup."""
        # Zero has two signs, which are one place.
        key = contact.body, (np.round(T_object_tool, 5) + 0.0).tobytes()
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
            self._points.note(length(gap) - pad.outer_radius, f"{where}: nothing seals there")
        angles = 2.0 * math.pi * np.arange(_RIM) / _RIM
        circle = radius * np.column_stack([np.cos(angles), np.sin(angles)])
        points = np.vstack([0.5 * circle, circle]) @ R[:, :2].T + T_object_tool[:3, 3]
        normals, near = shape.faces_near(points, self._settings.lip_give)
        slants = np.array([angle(R[:, 2], normal) for normal in normals])
        least = np.where(near, slants, math.pi).min(axis=1, initial=math.pi)
        self._normals.note(self._settings.pad_slant - float(least.max()), where)


def tool_touch_rule(plan: PlanView, steps: list[StateChange], index: int) -> TouchRule:
    """Pads and fingers may touch the tool that they hold, the cup its object, bodies at rest what carries them.

    In the motion before the vacuum goes on, and after it went off, the cup comes to the object or leaves it. A body
    that is taken off what carries it, or put down, touches it in the motion after or before.
    """
    step = steps[index]
    on_cup, supports = set(step.on_cup), [step.before.supports, step.after.supports]
    if step.segment.kind == "transfer":
        for following in steps[index + 1 : index + 2]:
            on_cup |= following.on_cup if following.segment.kind == "attach" else set()
            supports += [following.after.supports] if following.segment.kind in ("detach", "release") else []
        for before in steps[index - 1 : index]:
            on_cup |= before.on_cup if before.segment.kind == "detach" else set()
            # What carried bodies until the segment before this one took them off.
            supports += [before.before.supports] if before.segment.kind in ("attach", "grip") else []
    rests = {frozenset({name, other}) for known in supports for name, below in known.items() for other in below}
    sucked = {frozenset({TOOL, name}) for name in on_cup}
    gripped = {(grip.arm, grip.body) for each in holds_around(plan, step.segment) for grip in each.grips}
    return TouchRule(gripped, frozenset(), rests | sucked)


def tool_attachment_checks(evidence: Evidence, steps: list[StateChange]) -> list[Check]:
    """Check drift and turn of attached bodies, what may be attached to what, and bodies at rest."""
    finding = Finding("attachment_rules", "1")
    for step in steps:
        _rules(step, finding)
    carried = resting_check(evidence, lambda segment: {body for body, _ in segment.rides})
    return [*drift_checks(evidence), finding.check(), carried]


def _rules(step: StateChange, finding: Finding) -> None:
    segment, where = step.segment, step.segment.place()
    attached = {(body, ride.to) for body, ride in segment.rides}
    finding.require(len(attached) == len(segment.rides), where, "a body is attached twice to the same")
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
