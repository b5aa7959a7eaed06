"""Where the contacts of the tool and of objects are: the pads, the cup's lip, and what objects stand on."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from planners.certify.balances import ContactSet
from planners.certify.cones import angle, x_axis_error
from planners.certify.contact_places import ContactPlaceChecks, Maker
from planners.certify.disc import Disc
from planners.certify.motion import SegmentMotion
from planners.certify.plan_view import ContactView, PlanView
from planners.certify.settings import CertifySettings
from planners.certify.tool_task import TOOL
from planners.geometry.pose import Array, frame_from_z, inverse

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

    def _environment(self, motion: SegmentMotion, contact_set: ContactSet, contact: ContactView, where: str) -> None:
        if contact.by not in self._plan.bodies or contact.by == contact.body:
            self._points.require(False, where, "is no body that carries another")
            return
        T_world_by = motion.body_poses[contact.by][contact.sample]
        shape = self._plan.bodies[contact.by].shape
        self._on_surface(shape, T_world_by, contact.point, contact.normal, f"{where}: on {contact.by}")

    def _cup(self, motion: SegmentMotion, contact_set: ContactSet, contact: ContactView, where: str) -> None:
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
        pad = Disc(radius + self._settings.contact_distance, self._settings.lip_give, self._settings.seam)
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
