"""Every contact lies on both bodies that it joins, with the normal of the surface there."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod

import numpy as np

from planners.certify.common.cones import contact_name
from planners.certify.evidence import Evidence
from planners.certify.finding import Finding
from planners.certify.geometry.body_shape import BodyShape
from planners.certify.geometry.vectors import angle, length
from planners.certify.motion.segment_motion import BodyContacts, SegmentMotion
from planners.certify.plan_view import T_flange_tcp
from planners.geometry.pose import Array, Transform, inverse
from planners.plan.contacts import BearingContact, EnvironmentContact, PointContact, SoftFingerContact, SuctionContact
from planners.plan.verdicts import Check

_SAME_PLACE = 1e-7
"""Points that round to the same multiple of this are one place [m]; tolerances are thousands of it."""


class ContactPlaceChecks(ABC):
    """Looks at each contact from both sides: the body that it acts on, and who makes it."""

    def __init__(self, evidence: Evidence) -> None:
        self._evidence, self._plan, self._settings = evidence, evidence.plan, evidence.settings
        self._points = Finding("contact_points", "m")
        self._normals = Finding("contact_normals", "rad")
        self._known: dict[tuple[int, bytes], tuple[float, list[Array]]] = {}

    def run(self) -> list[Check]:
        """Check all contact sets."""
        for motion in self._evidence.motions:
            for contact_set in motion.contacts:
                for contact in contact_set.bearing:
                    self._contact(motion, contact_set, contact)
        return [self._points.check(), self._normals.check()]

    def _contact(self, motion: SegmentMotion, contact_set: BodyContacts, contact: BearingContact) -> None:
        where = f"{contact_set.where} by {contact_name(contact)}"
        body = self._plan.bodies[contact.body].shape
        # An edge or a corner of the body may press on a face: then the face alone has the normal.
        normal = None if contact.kind == "environment" else -contact.normal
        self._on_surface(
            body, contact_set.T_body_world, contact.point, normal, f"{where}: on {contact.body}", self._slant(contact)
        )
        match contact:
            case SoftFingerContact():
                self._finger(motion, contact, where)
            case PointContact():
                self._tip(motion, contact, where)
            case EnvironmentContact():
                self._carrier(motion, contact, where)
            case SuctionContact():
                self._cup(motion, contact_set, contact, where)

    def _slant(self, contact: BearingContact) -> float:
        """Return the largest angle between a contact's normal and that of the body it acts on [rad]."""
        return self._settings.contact_angle

    def _tip(self, motion: SegmentMotion, contact: PointContact, where: str) -> None:
        """Check a contact from the side of the tip that makes it; where nothing has tips, there is none."""
        self._points.require(False, where, f"nothing makes contacts of kind {contact.kind} here")

    @abstractmethod
    def _carrier(self, motion: SegmentMotion, contact: EnvironmentContact, where: str) -> None:
        """Check a contact from the side of the body that carries."""

    @abstractmethod
    def _cup(self, motion: SegmentMotion, contact_set: BodyContacts, contact: SuctionContact, where: str) -> None:
        """Check a contact from the side of the cup that makes it."""

    def _on_carrier(self, motion: SegmentMotion, contact: EnvironmentContact, where: str) -> None:
        shape, pose = self._plan.bodies[contact.by].shape, motion.body_poses[contact.by][contact.sample]
        self._on_surface(shape, inverse(pose), contact.point, contact.normal, f"{where}: on {contact.by}")

    def _on_surface(
        self,
        shape: BodyShape,
        T_body_world: Transform,
        point: Array,
        outward: Array | None,
        where: str,
        slant: float | None = None,
    ) -> None:
        local = T_body_world[:3, :3] @ point + T_body_world[:3, 3]
        height, normals = self._surface_at(shape, local)
        self._points.note(self._settings.contact_distance - abs(height), where)
        if outward is not None and height <= self._settings.contact_distance:
            direction = T_body_world[:3, :3] @ outward
            error = min((angle(direction, normal) for normal in normals), default=math.pi)
            self._normals.note((self._settings.contact_angle if slant is None else slant) - error, where)

    def _surface_at(self, shape: BodyShape, point: Array) -> tuple[float, list[Array]]:
        """Return the distance of a point of the body frame from the surface, and the normals near it.

        A held body is touched at one place through all of a motion, which is looked at once.
        """
        # Zero has two signs, which are one place.
        key = id(shape), (np.round(point / _SAME_PLACE) + 0.0).tobytes()
        if key not in self._known:
            height, _ = shape.surface_distance(point)
            self._known[key] = height, shape.normals_near(point, self._settings.contact_distance)
        return self._known[key]

    def _meets(self, contact: BearingContact, point: Array, normal: Array, where: str) -> None:
        distance = length(contact.point - point)
        self._points.note(self._settings.contact_distance - distance, where)
        self._normals.note(self._settings.contact_angle - angle(contact.normal, normal), where)

    def _finger(self, motion: SegmentMotion, contact: SoftFingerContact, where: str) -> None:
        gripper = self._plan.grippers.get(contact.by)
        if gripper is None:
            self._points.require(False, where, "has no fingers")
            return
        width = motion.segment.gripper_width[contact.by][contact.sample : contact.sample + 1]
        T_world_tcp = motion.frames[contact.by][contact.sample, 6] @ T_flange_tcp(gripper, width)[0]
        # Finger 0 is at -y and presses towards +y.
        inward = T_world_tcp[:3, 1] * (1.0 if contact.finger == 0 else -1.0)
        self._meets(contact, T_world_tcp[:3, 3] - inward * float(width[0]) / 2, inward, f"{where}: at the pad")
