"""What proves that no plan exists: more is needed than there can be; and the causes stated are that proof."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from planners.certify.evidence import Evidence
from planners.certify.finding import Finding
from planners.certify.motion.robot_surfaces import pad_face
from planners.certify.plan_view import BodyView, PlanView
from planners.certify.settings import CertifySettings
from planners.geometry.pose import Array
from planners.plan.scenery import HandDocument
from planners.plan.verdicts import Check

_TOLERANCES = 0.005
"""Where bodies rest, are held and end may be off by less, all in all [m]: contacts and attachments, goals and settling
of the contract."""


@dataclass(frozen=True)
class Bound:
    """What is needed against the most that there can be."""

    needed: float
    needed_as_stated: tuple[float, ...]
    """What a document may name as needed: every one of them would have to be met."""
    available: float
    second_opinion: Callable[[], float] | None = None
    """Finds what there is without the formulas that `available` comes from; None where it is but read and compared."""

    @property
    def missing(self) -> float:
        """Part of the need that cannot be met; the claim is proven where it is positive."""
        return 1.0 - self.available / self.needed


def reach_bound(plan: PlanView, point: Array, further: float) -> Bound:
    """Return how far a point is from the shoulder of the arm that misses it by least, and how far that one reaches [m].

    Args:
        plan: has arms and hands.
        point: (3,) in the world [m].
        further: what a hand reaches with, and how far around the point it may touch [m].
    """
    reaches = []
    for name, arm in plan.cell.arms.items():
        # Each row of the table stretched out from the shoulder: the point of the first axis that the joint turns about.
        shoulder = arm.T_world_base[:3, 3] + float(arm.dh[0, 2]) * arm.T_world_base[:3, 2]
        stretched = abs(float(arm.dh[0, 0])) + sum(math.hypot(a, d) for a, _, d, _ in arm.dh[1:].tolist())
        available = stretched + _hand_length(plan.cell.hands[name]) + further + _TOLERANCES
        reaches.append((float(np.linalg.norm(point - shoulder)), available))
    needed, available = max(reaches, key=lambda pair: pair[1] - pair[0])
    return Bound(max(needed, _TOLERANCES), (max(needed, _TOLERANCES),), available)


def body_radius(body: BodyView) -> float:
    """Return how far a body's farthest corner is from its origin [m]."""
    return float(np.linalg.norm(body.shape.vertices, axis=1).max())


def _hand_length(hand: HandDocument) -> float:
    """Return how far from the flange's origin a hand can touch anything: pads opened widest, or the tip's pole [m]."""
    if hand.kind == "stick":
        return float(np.linalg.norm(hand.T_flange_tip[:3, 3])) + hand.tip_radius
    width, length = pad_face()
    opening, height = hand.tcp.max(axis=0)
    return math.hypot(width / 2, float(opening) / 2, float(height) + length / 2)


def proof_check(evidence: Evidence, bounds: Mapping[str, Sequence[Bound]]) -> Check:
    """Check that one of the bounds, by unit, is a proof, and that each cause states the numbers of one of them.

    A cause may overstate what is available, as long as it is still less than what is needed; never understate it.
    """
    finding, settings = Finding("infeasibility", "1"), evidence.settings
    every = [(unit, bound) for unit, group in bounds.items() for bound in group]
    unit, best = max(every, key=lambda item: item[1].missing)
    finding.note(
        best.missing - settings.join,
        f"/explanation: {best.needed:.6g} {unit} needed, {best.available:.6g} {unit} available",
    )
    if best.second_opinion is not None and finding.margin >= 0.0:
        found = best.second_opinion()
        where = f"/explanation: {best.needed:.6g} {unit} needed, {found:.6g} {unit} available as the program finds"
        finding.note(1.0 - found / best.needed + settings.stated_bound, where)
    compared = False
    for index, cause in enumerate(evidence.plan.stated.explanation.causes):
        if cause.needed is None or cause.available is None:
            continue
        where, group = f"/explanation/causes/{index}", bounds.get(cause.unit or "")
        if group is None:
            finding.require(False, f"{where}/unit", f"nothing infeasible is measured in {cause.unit!r}")
            continue
        claims = [_claims(cause.needed, cause.available, bound, settings) for bound in group]
        for said, margin in max(claims, key=lambda found: min(found.values())).items():
            finding.note(margin, f"{where}/{said}")
        compared = True
    if not compared:
        finding.require(False, "/explanation/causes", "none states what makes the task infeasible")
    return finding.check()


def _claims(needed: float, available: float, bound: Bound, settings: CertifySettings) -> dict[str, float]:
    """Return the margins by which a cause says of a bound what is so: what was needed, what there is, that it lacks."""
    off = min(abs(needed - one) / bound.needed for one in bound.needed_as_stated)
    understated = (bound.available - available) / bound.needed
    return {
        f"needed: {needed:.6g}, not {bound.needed:.6g}": settings.stated_bound - off,
        f"available: {available:.6g}, not {bound.available:.6g}": settings.stated_bound - understated,
        f"available: {available:.6g} would suffice": 1.0 - available / bound.needed,
    }
