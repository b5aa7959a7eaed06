"""What hands bear, against what their arms' payloads leave beside them, whatever the task allows."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from planners.certify.balances import ContactSet
from planners.certify.finding import Finding
from planners.certify.plan_view import PlanView
from planners.certify.settings import CertifySettings
from planners.geometry.pose import Array
from planners.plan.scenery import ARMS
from planners.plan.verdicts import Check


def payload_limits(plan: PlanView) -> dict[str, float]:
    """Return the net force that each hand may exert [N]: an arm bears its payload, and the hand is part of it."""
    gravity = float(np.linalg.norm(plan.gravity))
    return {name: (arm.payload - plan.hands[name].mass) * gravity for name, arm in plan.arms.items()}


def net_forces(contact_set: ContactSet) -> dict[str, float]:
    """Return what each hand that touches the body exerts on it in all [N]."""
    return {
        arm: float(np.linalg.norm(np.sum([c.force for c in contact_set.contacts if c.by == arm], axis=0)))
        for arm in ARMS
        if any(c.by == arm for c in contact_set.contacts)
    }


class PayloadCheck:
    """The largest net force of each hand, of its contacts and of what is known of it besides."""

    def __init__(self, plan: PlanView, settings: CertifySettings) -> None:
        self._limits, self._slack = payload_limits(plan), settings.cone_slack
        self._finding = Finding("payload", "N")

    def note(self, arm: str, nets: Array, where: Callable[[int], str]) -> None:
        """Note net forces (n,) of a hand [N]."""
        self._finding.note_all(self._limits[arm] + self._slack - nets, where)

    def note_contacts(self, sets: Sequence[ContactSet]) -> None:
        """Note what contacts show."""
        for contact_set in sets:
            for arm, net in net_forces(contact_set).items():
                self._finding.note(self._limits[arm] + self._slack - net, f"{contact_set.where} by {arm}")

    def check(self) -> Check:
        """Close the check."""
        return self._finding.check()
