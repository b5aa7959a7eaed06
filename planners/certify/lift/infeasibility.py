"""What proves that a plate lift has no plan, derived again from the task.

There are three proofs. A lifted plate touches nothing but hands and cup, so a weight above the sum of what these can
bear cannot be lifted. And a plan ends with the plate gripped between two parallel faces, so a plate whose every pair of
parallel faces is farther apart than a gripper opens cannot be gripped. And nothing moves the plate before a hand
touches it where it lies. The first is asked of another solver as well.
"""

from __future__ import annotations

import math
from functools import partial

import numpy as np

from planners.certify.common.infeasibility import (
    Bound,
    body_radius,
    largest_lift,
    proof_check,
    reach_bound,
    stated_lift,
)
from planners.certify.evidence import Evidence
from planners.certify.geometry.body_shape import BodyShape
from planners.certify.lift.task import LiftTask
from planners.certify.plan_view import PlanView
from planners.contract.task_spec import PlateLiftTask
from planners.plan.verdicts import Check

_WEIGHTLESS = 1e-12
"""Stands for no weight at all, so that shares of it are numbers [N]."""


def lift_infeasibility_check(evidence: Evidence, task: LiftTask) -> Check:
    """Check that a plan without a solution is proven to have none, and that its causes state the proof's numbers."""
    plan, shape = evidence.plan, task.plate.shape
    assert shape is not None
    plate, widths = plan.plate, face_distances(shape)
    opening = Bound(min(widths), widths, plan.opening)
    reach = reach_bound(evidence, plate.T_world_start[:3, 3], body_radius(plate))
    return proof_check(evidence, {"N": (_weight_bound(plan, task),), "m": (opening, reach)})


def _weight_bound(plan: PlanView, task: LiftTask) -> Bound:
    """Return the plate's weight and a bound of all vertical force on a plate in the air [N]."""
    weight = max(_WEIGHTLESS, (task.plate.mass or 0.0) * float(np.linalg.norm(plan.cell.gravity)))
    most, model = task.hand_limits(plan), task.stated.lifter_model
    hands = [_hand_force(hand.kind, most[arm], task.stated) for arm, hand in plan.cell.hands.items()]
    second = partial(stated_lift, task.cup, model, hands)
    return Bound(weight, (weight,), largest_lift(task.cup, model) + sum(hands), second)


def _hand_force(kind: str, most: float, task: PlateLiftTask) -> float:
    """Return the largest norm of one hand's net force: its limit, or what its normals and their friction allow [N]."""
    contacts, friction = (2, task.friction.grip) if kind == "gripper" else (1, task.friction.push)
    return min(most, contacts * task.hand_force_limit.normal * math.hypot(1.0, friction))


def face_distances(shape: BodyShape) -> tuple[float, float]:
    """Return thickness (along z) and the narrowest width from side to side of a prism [m].

    The width of a convex outline is smallest square to one of its sides.
    """
    normals = np.vstack([part.planes[:, :3] for part in shape.parts])
    sides = normals[np.abs(normals[:, 2]) < 0.5]
    return float(np.ptp(shape.vertices[:, 2])), float(np.ptp(shape.vertices @ sides.T, axis=0).min())
