"""What contacts leave of every limit: of what arms can carry, and of all limits the reserve that the document states.

The reserve is the largest share of all force limits (friction, what hands may bear, force, friction and stiffness of a
cup) that could be missing with the contacts still within them. The squeeze of a gripper is commanded, and is no limit:
of a finger that squeezes, friction counts, and what it presses beyond the squeeze.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from planners.certify.common.cones import contact_name, pad_loads
from planners.certify.evidence import Evidence
from planners.certify.finding import Finding
from planners.certify.geometry.vectors import length
from planners.certify.motion.segment_motion import BodyContacts
from planners.certify.plan_view import NumberedSegment, PlanView
from planners.geometry.pose import Array
from planners.plan.contacts import EnvironmentContact, PointContact, SoftFingerContact, SuctionContact
from planners.plan.verdicts import Check

_NOTHING = 1e-12
"""Stands for a limit that is none [N, Nm]."""


def payload_limits(plan: PlanView) -> dict[str, float]:
    """Return the net force that each hand may exert [N]: an arm bears its payload, and the hand is part of it."""
    gravity = float(np.linalg.norm(plan.cell.gravity))
    limits: dict[str, float] = {}
    for name, arm in plan.cell.arms.items():
        hand = plan.cell.hands[name]
        assert arm.payload is not None, "a document without it is no plan view"
        assert hand.mass is not None, "a document without it is no plan view"
        limits[name] = (arm.payload - hand.mass) * gravity
    return limits


def payload_check(evidence: Evidence, carried: Iterable[tuple[NumberedSegment, str, Array]] = ()) -> Check:
    """Check what each hand exerts in all, by its contacts and by what is known of it besides, against its payload.

    Args:
        evidence: of the document.
        carried: segment, arm and (n,) net forces of its hand [N].
    """
    finding, slack = Finding("payload", "N"), evidence.settings.cone_slack
    limits = payload_limits(evidence.plan)
    for contact_set in evidence.contacts:
        for arm, net in contact_set.net_forces.items():
            finding.note(limits[arm] + slack - net, f"{contact_set.where} by {arm}")
    for segment, arm, nets in carried:
        finding.note_all(limits[arm] + slack - nets, lambda i, s=segment, by=arm: f"{s.place(i)} by {by}")
    return finding.check()


@dataclass(frozen=True)
class Use:
    """To which part limits could shrink and a contact set be still within them."""

    used: float
    """[1]"""
    what: str


def reserve_check(
    evidence: Evidence, hands: Mapping[str, float], model: str, contact_sets: Sequence[BodyContacts]
) -> Check:
    """Check the reserves that a document states against what its contacts leave; the margin is the smallest left.

    Where the document states more than there is, the margin is by how much less there is.

    Args:
        evidence: of the document.
        hands: by arm, the largest net force that its hand may exert [N].
        model: of the cup: "paper", "cable" or "dexnet".
        contact_sets: of the document, with whatever else its contacts have to be possible as.
    """
    settings = evidence.settings
    least, where = 1.0, "nothing is held"
    short, short_where = math.inf, ""
    for contact_set in contact_sets:
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
    for margin, complaint in _stated(evidence.plan, least, settings.stated_reserve):
        if margin < short:
            short, short_where = margin, complaint
    if short < -settings.stated_reserve:
        return Check(name="reserve", passed=False, margin=float(short), unit="1", where=short_where)
    passed = bool(least >= -settings.stated_reserve)
    return Check(name="reserve", passed=passed, margin=float(least), unit="1", where=where)


def _stated(plan: PlanView, least: float, rounding: float) -> Iterator[tuple[float, str]]:
    """Yield by how much less there is than the document states as its smallest, of contacts and of its curve."""
    stated = plan.stated.statistics.reserve
    if stated is None:
        return
    yield least - stated.value, f"the smallest reserve: {stated.value:g} is stated"
    curves = [segment.reserve for segment in plan.segments]
    known = [float(np.nanmin(c)) for c in curves if c is not None and not np.isnan(c).all()]
    yield min(known, default=1.0) - stated.value, "the smallest reserve is not that of the segments"
    there = 0 <= stated.segment < len(curves) and curves[stated.segment] is not None
    curve = curves[stated.segment] if there else None
    found = math.nan if curve is None or not 0 <= stated.sample < len(curve) else float(curve[stated.sample])
    if not abs(found - stated.value) <= rounding:
        yield -1.0, f"the smallest reserve is not at sample {stated.sample} of segment {stated.segment}"


def uses(contact_set: BodyContacts, hands: Mapping[str, float], model: str, slack: float) -> Iterator[Use]:
    """Yield to which part each limit could shrink that the contacts of one body meet.

    Args:
        contact_set: of one body at one sample.
        hands: by arm, the largest net force that its hand may exert [N].
        model: of the cup.
        slack: force that counts as none [N].
    """
    for contact in contact_set.bearing:
        yield from _of_cup(contact, model, slack) if contact.kind == "suction" else _of_contact(contact, slack)
    for arm, net in contact_set.net_forces.items():
        yield Use(max(0.0, net - slack) / hands[arm], f"{arm} hand's payload")


def _of_contact(contact: SoftFingerContact | PointContact | EnvironmentContact, slack: float) -> Iterator[Use]:
    name, squeeze = contact_name(contact), 0.0
    pressed = float(contact.force @ contact.normal)
    sliding = length(contact.force - pressed * contact.normal)
    if contact.kind == "soft_finger":
        squeeze = contact.squeeze or 0.0
        sliding = math.hypot(sliding, float(contact.torque @ contact.normal) / max(contact.eps, _NOTHING))
    yield Use(max(0.0, sliding - slack) / max(contact.mu * pressed, _NOTHING), f"friction of {name}")
    if contact.limit is not None:
        room = max(contact.limit - squeeze, _NOTHING)
        yield Use(max(0.0, pressed - squeeze - slack) / room, f"force of {name}")


def _of_cup(contact: SuctionContact, model: str, slack: float) -> Iterator[Use]:
    force, limit = max(contact.suction_force, 0.0), contact.limit
    yield Use(max(0.0, force - slack) / limit, "cup: pull")
    if model == "cable":
        return
    _, shear, twist, bend = pad_loads(contact)
    peel = math.pi * contact.radius * contact.kappa
    yield Use(max(0.0, math.sqrt(2.0) * np.abs(bend).max() - slack) / max(peel, _NOTHING), "cup: bending")
    friction = "cup: friction", "cup: friction against twisting"
    for across, what in zip((np.abs(shear).max(), abs(twist) / contact.radius), friction, strict=True):
        needed = max(0.0, math.sqrt(3.0) * float(across) - slack) / max(contact.mu, _NOTHING)
        if model == "paper":
            yield Use(needed / max(force, _NOTHING), what)
        else:
            # The least u with needed <= u (u limit - force): force and friction both shrink.
            yield Use(0.5 * (force + math.sqrt(force**2 + 4.0 * limit * needed)) / limit, what)
