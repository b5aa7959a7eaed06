"""What proves that no plan exists, derived again from the task.

There are three proofs. A lifted plate touches nothing but hands and cup, so a weight above the sum of what these can
bear cannot be lifted. And a plan ends with the plate gripped between two parallel faces, so a plate whose every pair of
parallel faces is farther apart than a gripper opens cannot be gripped. And nothing moves the plate before a hand
touches it where it lies. The first is asked of another solver as well.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import partial

import numpy as np

from planners.certify.arm_span import body_radius, reach_bound
from planners.certify.body_shape import BodyShape
from planners.certify.bound import Bound
from planners.certify.cones import StatedCup
from planners.certify.finding import Finding
from planners.certify.lift_program import stated_lift
from planners.certify.lift_task import LiftTask
from planners.certify.plan_view import PlanView
from planners.certify.settings import CertifySettings
from planners.plan.verdicts import Cause, Check

_WEIGHTLESS = 1e-12
"""Stands for no weight at all, so that shares of it are numbers [N]."""


def infeasibility_check(plan: PlanView, task: LiftTask, settings: CertifySettings) -> Check:
    """Check that a plan without a solution is proven to have none, and that its causes state the proof's numbers.

    A cause may overstate what is available, as long as it is still less than what is needed; never understate it.
    """
    plate = plan.bodies["plate"]
    reach = reach_bound(plan, plate.T_world_start[:3, 3], body_radius(plate))
    bounds = {"N": (weight_bound(plan, task),), "m": (opening_bound(plan, task), reach)}
    return proof_check(plan, bounds, settings)


def proof_check(plan: PlanView, bounds: Mapping[str, Sequence[Bound]], settings: CertifySettings) -> Check:
    """Check that one of the bounds, by unit, is a proof, and that each cause states the numbers of one of them."""
    finding = Finding("infeasibility", "1")
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
    causes = () if plan.explanation is None else plan.explanation.causes
    stated = [_cause(cause, index, bounds, finding, settings) for index, cause in enumerate(causes)]
    if not any(stated):
        finding.require(False, "/explanation/causes", "none states what makes the task infeasible")
    return finding.check()


def _cause(
    cause: Cause,
    index: int,
    bounds: Mapping[str, Sequence[Bound]],
    finding: Finding,
    settings: CertifySettings,
) -> bool:
    """Compare a cause's numbers with those derived again; return whether it has any."""
    if cause.needed is None or cause.available is None:
        return False
    where = f"/explanation/causes/{index}"
    group = bounds.get(cause.unit or "")
    if group is None:
        finding.require(False, f"{where}/unit", f"nothing infeasible is measured in {cause.unit!r}")
        return False
    claims = max((_claims(cause, bound, settings) for bound in group), key=lambda found: min(found.values()))
    for said, margin in claims.items():
        finding.note(margin, f"{where}/{said}")
    return True


def _claims(cause: Cause, bound: Bound, settings: CertifySettings) -> dict[str, float]:
    """Return the margins by which a cause says of a bound what is so: what was needed, what there is, that it lacks."""
    assert cause.needed is not None
    assert cause.available is not None
    off = min(abs(cause.needed - needed) / bound.needed for needed in bound.needed_as_stated)
    understated = (bound.available - cause.available) / bound.needed
    return {
        f"needed: {cause.needed:.6g}, not {bound.needed:.6g}": settings.stated_bound - off,
        f"available: {cause.available:.6g}, not {bound.available:.6g}": settings.stated_bound - understated,
        f"available: {cause.available:.6g} would suffice": 1.0 - cause.available / bound.needed,
    }


def weight_bound(plan: PlanView, task: LiftTask) -> Bound:
    """Return the plate's weight and a bound of all vertical force on a plate in the air [N]."""
    weight = max(_WEIGHTLESS, (task.plate.mass or 0.0) * float(np.linalg.norm(plan.gravity)))
    most = task.hand_limits(plan)
    hands = [_hand_force(hand.kind, most[arm], task) for arm, hand in plan.hands.items()]
    second = partial(stated_lift, task.cup, task.lifter_model, hands)
    return Bound(weight, (weight,), largest_lift(task.cup, task.lifter_model) + sum(hands), second)


def largest_lift(cup: StatedCup, model: str) -> float:
    """Return the largest vertical force of the lifter on a plate at any tilt [N].

    Tilted by t, a pull p and a shear s along the plate have the vertical part p cos t + s sin t, whose largest value
    over t is hypot(p, s). By (5f) sqrt(3)|s_x| and sqrt(3)|s_y| are at most mu p, thus s at most sqrt(2/3) mu p; in the
    model `dexnet` mu (V - p) stands for mu p, and the value is convex in p, so largest at an end of 0 <= p <= V.
    """
    shear = math.sqrt(2.0 / 3.0) * cup.mu
    if model == "cable":
        return cup.max_force
    if model == "dexnet":
        return cup.max_force * max(1.0, shear)
    return cup.max_force * math.hypot(1.0, shear)


def _hand_force(kind: str, most: float, task: LiftTask) -> float:
    """Return the largest norm of one hand's net force: its limit, or what its normals and their friction allow [N]."""
    contacts, friction = (2, task.friction["grip"]) if kind == "gripper" else (1, task.friction["push"])
    return min(most, contacts * task.normal_limit * math.hypot(1.0, friction))


def opening_bound(plan: PlanView, task: LiftTask) -> Bound:
    """Return how far a gripper must open for the plate, between whatever faces, and how far one opens [m]."""
    assert task.plate.shape is not None
    widths = face_distances(task.plate.shape)
    open_widths = [float(hand.tcp_table[-1, 0]) for hand in plan.hands.values() if hand.tcp_table is not None]
    return Bound(min(widths), widths, max(open_widths, default=0.0))


def face_distances(shape: BodyShape) -> tuple[float, float]:
    """Return thickness (along z) and the narrowest width from side to side of a prism [m].

    The width of a convex outline is smallest square to one of its sides.
    """
    normals = np.vstack([part.planes[:, :3] for part in shape.parts])
    sides = normals[np.abs(normals[:, 2]) < 0.5]
    return float(np.ptp(shape.vertices[:, 2])), float(np.ptp(shape.vertices @ sides.T, axis=0).min())
