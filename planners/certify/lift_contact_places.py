"""Where the contacts of a lifted plate are: the stick's tip, the support and the lifter's cup."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from planners.certify.balances import ContactSet
from planners.certify.cones import x_axis_error
from planners.certify.contact_places import ContactPlaceChecks, Maker
from planners.certify.contact_states import support_height
from planners.certify.lift_task import LiftTask
from planners.certify.motion import SegmentMotion
from planners.certify.plan_view import ContactView, PlanView
from planners.certify.settings import CertifySettings


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

    def _tip(self, motion: SegmentMotion, contact_set: ContactSet, contact: ContactView, where: str) -> None:
        hand = self._plan.hands.get(contact.by)
        if hand is None or hand.T_flange_tip is None:
            self._points.require(False, where, "has no tip")
            return
        T_world_flange = motion.frames[contact.by][contact.sample, 6]
        tip = T_world_flange[:3, :3] @ hand.T_flange_tip[:3, 3] + T_world_flange[:3, 3]
        self._meets(contact, tip + hand.tip_radius * contact.normal, contact.normal, f"{where}: at the tip")

    def _environment(self, motion: SegmentMotion, contact_set: ContactSet, contact: ContactView, where: str) -> None:
        if contact.by != self._plan.support:
            self._points.require(False, where, f"{contact.body} rests on {self._plan.support}")
            return
        above = float(contact.point[2]) - support_height(self._plan)
        self._points.note(self._settings.contact_distance - abs(above), f"{where}: height of {contact.by}")
        pose = motion.body_poses[contact.by][contact.sample]
        self._on_surface(
            self._plan.bodies[contact.by].shape, pose, contact.point, contact.normal, f"{where}: on {contact.by}"
        )

    def _pad(self, motion: SegmentMotion, contact_set: ContactSet, contact: ContactView, where: str) -> None:
        if contact.by != "cup" or contact.body != "plate":
            self._points.require(False, where, "only the cup sucks, and only at the plate")
            return
        T = contact_set.T_world_body
        top = float(self._plan.bodies["plate"].shape.vertices[:, 2].max())
        point = T[:3, :3] @ np.append(self._task.cup.position, top) + T[:3, 3]
        self._meets(contact, point, -T[:3, 2], f"{where}: at the cup")
        error = x_axis_error(contact, T)
        self._normals.note(self._settings.contact_angle - error, f"{where}: x axis")
