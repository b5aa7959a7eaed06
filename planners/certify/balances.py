"""Contact sets, and their balances, assembled again in the world frame."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from planners.certify.finding import Finding
from planners.certify.motion import SegmentMotion
from planners.certify.plan_view import BodyView, ContactView, PlanView, SegmentView
from planners.certify.settings import CertifySettings
from planners.geometry.pose import Array, Transform
from planners.plan.verdicts import Check


@dataclass(frozen=True, eq=False)
class ContactSet:
    """All contacts on one body at one sample."""

    segment: SegmentView
    sample: int
    body: str
    T_world_body: Transform
    contacts: tuple[ContactView, ...]

    @property
    def where(self) -> str:
        """Name the set."""
        return f"{self.segment.place(self.sample)}: {self.body}"


def contact_sets(motion: SegmentMotion) -> list[ContactSet]:
    """Group a segment's contacts by body and sample, in order of time."""
    groups: dict[tuple[str, int], list[ContactView]] = defaultdict(list)
    for contact in motion.segment.contacts:
        groups[contact.body, contact.sample].append(contact)
    return [
        ContactSet(motion.segment, sample, body, motion.body_poses[body][sample], tuple(contacts))
        for (body, sample), contacts in sorted(groups.items(), key=lambda item: item[0])
    ]


def balance_checks(plan: PlanView, sets: Sequence[Sequence[ContactSet]], settings: CertifySettings) -> list[Check]:
    """Check forces and moments of the contact sets of each segment."""
    force, moment = Finding("balance_force", "N"), Finding("balance_moment", "Nm")
    for contact_set in (one for group in sets for one in group):
        body = plan.bodies[contact_set.body]
        if body.mass is None:
            force.require(False, contact_set.where, "has contacts and no mass")
            continue
        total_force, total_moment = residual(contact_set, body, plan.gravity)
        force.note(settings.force_balance - float(np.linalg.norm(total_force)), contact_set.where)
        moment.note(settings.moment_balance - float(np.linalg.norm(total_moment)), contact_set.where)
    return [force.check(), moment.check()]


def residual(contact_set: ContactSet, body: BodyView, gravity: Array) -> tuple[Array, Array]:
    """Return what is left of force [N] and moment about the centre of mass [Nm], world axes."""
    T = contact_set.T_world_body
    com = T[:3, :3] @ body.com + T[:3, 3]
    force, moment = (body.mass or 0.0) * gravity, np.zeros(3)
    for contact in contact_set.contacts:
        force = force + contact.force
        moment = moment + contact.torque + np.cross(contact.point - com, contact.force)
    return force, moment
