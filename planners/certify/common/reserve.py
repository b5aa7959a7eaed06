"""What contacts leave of every limit: of what arms can carry, and of all limits the reserve that the document states.

The reserve is the largest share of all force limits (friction, what hands may bear, force, friction and stiffness of a
cup) that could be missing with the contacts still within them. The squeeze of a gripper is commanded, and is no limit:
of a finger that squeezes, friction counts, and what it presses beyond the squeeze.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from planners.certify.finding import Finding
from planners.certify.motion.segment_motion import BodyContacts
from planners.certify.plan_view import ContactView, PlanView
from planners.certify.settings import CertifySettings
from planners.geometry.pose import Array
from planners.plan.scenery import ARMS
from planners.plan.verdicts import Check

_NOTHING = 1e-12
"""Stands for a limit that is none [N, Nm]."""


def payload_limits(plan: PlanView) -> dict[str, float]:
    """Return the net force that each hand may exert [N]: an arm bears its payload, and the hand is part of it."""
    gravity = float(np.linalg.norm(plan.gravity))
    return {name: (arm.payload - plan.hands[name].mass) * gravity for name, arm in plan.arms.items()}


def net_forces(contact_set: BodyContacts) -> dict[str, float]:
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

    def note_contacts(self, sets: Sequence[BodyContacts]) -> None:
        """Note what contacts show."""
        for contact_set in sets:
            for arm, net in net_forces(contact_set).items():
                self._finding.note(self._limits[arm] + self._slack - net, f"{contact_set.where} by {arm}")

    def check(self) -> Check:
        """Close the check."""
        return self._finding.check()


@dataclass(frozen=True)
class Use:
    """To which part limits could shrink and a contact set be still within them."""

    used: float
    """[1]"""
    what: str


def reserve_check(
    plan: PlanView, sets: Sequence[BodyContacts], hands: Mapping[str, float], model: str, settings: CertifySettings
) -> Check:
    """Check the reserves that a document states against what its contacts leave; the margin is the smallest left.

    Where the document states more than there is, the margin is by how much less there is.

    Args:
        plan: the document.
        sets: all contact sets.
        hands: by arm, the largest net force that its hand may exert [N].
        model: of the cup: "paper", "cable" or "dexnet".
        settings: tolerances.
    """
    least, where = 1.0, "nothing is held"
    short, short_where = math.inf, ""
    for contact_set in sets:
        use = max(uses(contact_set, hands, model, settings.cone_slack), key=lambda each: each.used, default=None)
        if use is None:
            continue
        left, place = 1.0 - use.used, f"{contact_set.where}, {use.what}"
        if left < least:
            least, where = left, place
        curve = contact_set.segment.reserve
        stated = math.nan if curve is None else float(curve[contact_set.sample])
        if not math.isnan(stated) and left - stated < short:
            short, short_where = left - stated, f"{place}: {stated:g} is stated"
    for margin, complaint in _stated(plan, least, settings):
        if margin < short:
            short, short_where = margin, complaint
    if short < -settings.stated_reserve:
        return Check(name="reserve", passed=False, margin=float(short), unit="1", where=short_where)
    passed = bool(least >= -settings.stated_reserve)
    return Check(name="reserve", passed=passed, margin=float(least), unit="1", where=where)


def _stated(plan: PlanView, least: float, settings: CertifySettings) -> Iterator[tuple[float, str]]:
    """Yield by how much less there is than the document states as its smallest, of contacts and of its curve."""
    stated = plan.least_reserve
    if stated is None:
        return
    yield least - stated.value, f"the smallest reserve: {stated.value:g} is stated"
    curves = [segment.reserve for segment in plan.segments]
    known = [float(np.nanmin(c)) for c in curves if c is not None and not np.isnan(c).all()]
    yield min(known, default=1.0) - stated.value, "the smallest reserve is not that of the segments"
    there = 0 <= stated.segment < len(curves) and curves[stated.segment] is not None
    curve = curves[stated.segment] if there else None
    found = math.nan if curve is None or not 0 <= stated.sample < len(curve) else float(curve[stated.sample])
    if not abs(found - stated.value) <= settings.stated_reserve:
        yield -1.0, f"the smallest reserve is not at sample {stated.sample} of segment {stated.segment}"


def uses(contact_set: BodyContacts, hands: Mapping[str, float], model: str, slack: float) -> Iterator[Use]:
    """Yield to which part each limit could shrink that the contacts of one body meet.

    Args:
        contact_set: of one body at one sample.
        hands: by arm, the largest net force that its hand may exert [N].
        model: of the cup.
        slack: force that counts as none [N].
    """
    for contact in contact_set.contacts:
        if contact.kind == "suction":
            yield from _of_cup(contact, model, slack)
        elif contact.kind != "inertia":
            yield from _of_contact(contact, slack)
    for arm, net in net_forces(contact_set).items():
        yield Use(max(0.0, net - slack) / hands[arm], f"{arm} hand's payload")


def _of_contact(contact: ContactView, slack: float) -> Iterator[Use]:
    values, name = contact, contact.by if contact.finger is None else f"{contact.by} finger {contact.finger}"
    pressed = float(contact.force @ contact.normal)
    sliding = float(np.linalg.norm(contact.force - pressed * contact.normal))
    if contact.kind == "soft_finger":
        sliding = math.hypot(sliding, float(contact.torque @ contact.normal) / max(values.eps, _NOTHING))
    yield Use(max(0.0, sliding - slack) / max(values.mu * pressed, _NOTHING), f"friction of {name}")
    if values.limit < math.inf:
        squeeze = values.squeeze or 0.0
        room = max(values.limit - squeeze, _NOTHING)
        yield Use(max(0.0, pressed - squeeze - slack) / room, f"force of {name}")


def _of_cup(contact: ContactView, model: str, slack: float) -> Iterator[Use]:
    values = contact
    force, limit = max(values.suction_force, 0.0), values.limit
    yield Use(max(0.0, force - slack) / limit, "cup: pull")
    if model == "cable":
        return
    axes = np.array([contact.x_axis, np.cross(contact.normal, contact.x_axis)])
    shear, bend = np.abs(axes @ contact.force).max(), np.abs(axes @ contact.torque).max()
    twist = abs(float(contact.torque @ contact.normal))
    peel = math.pi * values.radius * values.kappa
    yield Use(max(0.0, math.sqrt(2.0) * bend - slack) / max(peel, _NOTHING), "cup: bending")
    for across, what in ((shear, "cup: friction"), (twist / values.radius, "cup: friction against twisting")):
        needed = max(0.0, math.sqrt(3.0) * float(across) - slack) / max(values.mu, _NOTHING)
        if model == "paper":
            yield Use(needed / max(force, _NOTHING), what)
        else:
            # The least u with needed <= u (u limit - force): force and friction both shrink.
            yield Use(0.5 * (force + math.sqrt(force**2 + 4.0 * limit * needed)) / limit, what)
