"""Every contact lies on both bodies that it joins, with the normal of the surface there."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from planners.certify.common.cones import angle
from planners.certify.finding import Finding
from planners.certify.geometry.body_shape import BodyShape
from planners.certify.motion.segment_motion import BodyContacts, SegmentMotion
from planners.certify.plan_view import ContactView, PlanView
from planners.certify.settings import CertifySettings
from planners.geometry.pose import Array, Transform, inverse
from planners.plan.scenery import ARMS
from planners.plan.verdicts import Check

Maker = Callable[[SegmentMotion, BodyContacts, ContactView, str], None]
"""Checks a contact from the side of who makes it; the text names the contact."""
_SAME_PLACE = 1e-7
"""Points that round to the same multiple of this are one place [m]; tolerances are thousands of it."""


class ContactPlaceChecks(ABC):
    """Looks at each contact from both sides: the body that it acts on, and who makes it."""

    def __init__(self, plan: PlanView, settings: CertifySettings) -> None:
        self._plan, self._settings = plan, settings
        self._points = Finding("contact_points", "m")
        self._normals = Finding("contact_normals", "rad")
        self._known: dict[tuple[int, bytes], tuple[float, list[Array]]] = {}

    def run(self, motions: Sequence[SegmentMotion], sets: Sequence[Sequence[BodyContacts]]) -> list[Check]:
        """Check all contact sets of each segment."""
        for motion, group in zip(motions, sets, strict=True):
            for contact_set in group:
                for contact in contact_set.contacts:
                    if contact.kind != "inertia":
                        self._contact(motion, contact_set, contact)
        return [self._points.check(), self._normals.check()]

    def _contact(self, motion: SegmentMotion, contact_set: BodyContacts, contact: ContactView) -> None:
        finger = "" if contact.finger is None else f" finger {contact.finger}"
        where = f"{contact_set.where} by {contact.by}{finger}"
        body = self._plan.bodies[contact.body].shape
        T = contact_set.T_world_body
        # An edge or a corner of the body may press on a face: then the face alone has the normal.
        normal = None if contact.kind == "environment" else -contact.normal
        slant = self._slant(contact)
        self._on_surface(body, T, contact.point, normal, f"{where}: on {contact.body}", slant)
        maker = self._makers().get(contact.kind)
        if maker is None:
            self._points.require(False, where, f"nothing makes contacts of kind {contact.kind} here")
        else:
            maker(motion, contact_set, contact, where)

    def _slant(self, contact: ContactView) -> float:
        """Return the largest angle between a contact's normal and that of the body it acts on [rad]."""
        return self._settings.contact_angle

    @abstractmethod
    def _makers(self) -> Mapping[str, Maker]:
        """Return who makes contacts of each kind."""

    def _on_surface(
        self,
        shape: BodyShape,
        T_world_body: Transform,
        point: Array,
        outward: Array | None,
        where: str,
        slant: float | None = None,
    ) -> None:
        T_body_world = inverse(T_world_body)
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
        key = id(shape), np.round(point / _SAME_PLACE).tobytes()
        if key not in self._known:
            height, _ = shape.surface_distance(point)
            self._known[key] = height, shape.normals_near(point, self._settings.contact_distance)
        return self._known[key]

    def _meets(self, contact: ContactView, point: Array, normal: Array, where: str) -> None:
        distance = float(np.linalg.norm(contact.point - point))
        self._points.note(self._settings.contact_distance - distance, where)
        self._normals.note(self._settings.contact_angle - angle(contact.normal, normal), where)

    def _finger(self, motion: SegmentMotion, contact_set: BodyContacts, contact: ContactView, where: str) -> None:
        if contact.by not in ARMS or self._plan.hands[contact.by].kind != "gripper":
            self._points.require(False, where, "has no fingers")
            return
        width = motion.segment.widths[contact.by][contact.sample : contact.sample + 1]
        T_flange_tcp = self._plan.hands[contact.by].T_flange_tcp(width)[0]
        T_world_tcp = motion.frames[contact.by][contact.sample, 6] @ T_flange_tcp
        # Finger 0 is at -y and presses towards +y.
        inward = T_world_tcp[:3, 1] * (1.0 if contact.finger == 0 else -1.0)
        self._meets(contact, T_world_tcp[:3, 3] - inward * float(width[0]) / 2, inward, f"{where}: at the pad")
