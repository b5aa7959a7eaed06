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

from planners.certify.common.infeasibility import Bound, body_radius, proof_check, reach_bound
from planners.certify.common.lift_capacity import largest_lift, stated_lift
from planners.certify.geometry.body_shape import BodyShape
from planners.certify.lift.task import LiftTask
from planners.certify.plan_view import PlanView
from planners.certify.settings import CertifySettings
from planners.plan.verdicts import Check

_WEIGHTLESS = 1e-12
"""Stands for no weight at all, so that shares of it are numbers [N]."""


def lift_infeasibility_check(plan: PlanView, task: LiftTask, settings: CertifySettings) -> Check:
    """Check that a plan without a solution is proven to have none, and that its causes state the proof's numbers.

    A cause may overstate what is available, as long as it is still less than what is needed; never understate it.
    """
    plate = plan.bodies["plate"]
    reach = reach_bound(plan, plate.T_world_start[:3, 3], body_radius(plate))
    bounds = {"N": (weight_bound(plan, task),), "m": (opening_bound(plan, task), reach)}
    return proof_check(plan, bounds, settings)


def weight_bound(plan: PlanView, task: LiftTask) -> Bound:
    """Return the plate's weight and a bound of all vertical force on a plate in the air [N]."""
    weight = max(_WEIGHTLESS, (task.plate.mass or 0.0) * float(np.linalg.norm(plan.gravity)))
    most = task.hand_limits(plan)
    hands = [_hand_force(hand.kind, most[arm], task) for arm, hand in plan.hands.items()]
    second = partial(stated_lift, task.cup, task.lifter_model, hands)
    return Bound(weight, (weight,), largest_lift(task.cup, task.lifter_model) + sum(hands), second)


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
