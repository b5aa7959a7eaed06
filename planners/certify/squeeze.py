"""Grippers squeeze as their holds command: in their range, all along a hold, with both fingers together.

A parallel gripper commands a squeeze: each pad presses with it while nothing else acts, and a load along the closing
axis adds half of itself to one pad and takes it from the other. So the normal forces of both fingers add up to twice
the squeeze.
"""

from __future__ import annotations

from collections.abc import Sequence

from planners.certify.balances import ContactSet
from planners.certify.finding import Finding
from planners.certify.plan_view import PlanView, SegmentView
from planners.certify.settings import CertifySettings
from planners.plan.scenery import ARMS
from planners.plan.segment import Grip
from planners.plan.verdicts import Check


def squeeze_check(
    plan: PlanView, sets: Sequence[ContactSet], settings: CertifySettings, *, required: bool = True
) -> Check:
    """Check the squeezes of all grips, and that the contacts of their fingers are those of a squeeze.

    Args:
        plan: the document.
        sets: all contact sets.
        settings: tolerances.
        required: whether every grip has to state its squeeze; else those are passed over that do not.
    """
    finding = Finding("squeeze", "N")
    _range(plan, finding, settings, required=required)
    _constancy(plan, finding, settings)
    for contact_set in sets:
        _contacts(contact_set, finding, settings, required=required)
    return finding.check()


def _range(plan: PlanView, finding: Finding, settings: CertifySettings, *, required: bool) -> None:
    for segment in plan.segments:
        for grip in segment.grips:
            where = f"{segment.place()}: {grip.arm} hand"
            force_range = plan.hands[grip.arm].force_range
            if grip.squeeze is None:
                if required:
                    finding.require(False, where, "no squeeze is stated")
            elif force_range is None:
                finding.require(False, where, "nothing is known of how hard its gripper squeezes")
            else:
                least, most = force_range
                finding.note(min(grip.squeeze - least, most - grip.squeeze) + settings.cone_slack, where)


def _constancy(plan: PlanView, finding: Finding, settings: CertifySettings) -> None:
    """A hold lasts from segment to segment for as long as its hand has a grip of its body, up to a release."""
    held: dict[str, Grip] = {}
    for segment in plan.segments:
        grips = {grip.arm: grip for grip in segment.grips}
        for arm, grip in grips.items():
            before = held.get(arm)
            if before is not None and before.body == grip.body and grip.squeeze != before.squeeze:
                change = abs((grip.squeeze or 0.0) - (before.squeeze or 0.0))
                finding.note(settings.cone_slack - change, f"{segment.place()}: {arm} hand, not as before")
        held = {arm: grip for arm, grip in grips.items() if not _lets_go(segment, grip)}


def _lets_go(segment: SegmentView, grip: Grip) -> bool:
    return segment.kind == "release" and grip is segment.grip


def _contacts(contact_set: ContactSet, finding: Finding, settings: CertifySettings, *, required: bool) -> None:
    commanded = {grip.arm: grip.squeeze for grip in contact_set.segment.grips}
    for arm in ARMS:
        fingers = [c for c in contact_set.contacts if c.by == arm and c.kind == "soft_finger"]
        if not fingers:
            continue
        where, squeeze = f"{contact_set.where} by {arm}", commanded.get(arm)
        if squeeze is None:
            if required:
                finding.require(False, where, "no squeeze is commanded")
            continue
        for finger in fingers:
            stated = finger.squeeze
            if stated is None:
                finding.require(False, f"{where} finger {finger.finger}", "states no squeeze")
            else:
                finding.note(settings.cone_slack - abs(stated - squeeze), f"{where} finger {finger.finger}: squeeze")
        pressed = sum(float(finger.force @ finger.normal) for finger in fingers)
        finding.note(settings.cone_slack - abs(pressed - 2.0 * squeeze), f"{where}: both fingers together")
