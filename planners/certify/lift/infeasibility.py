"""What proves that a plate lift has no plan, derived again from the task.

There are three proofs. A lifted plate touches nothing but hands and cup, so a weight above the sum of what these can
bear cannot be lifted. And a plan ends with the plate gripped between two faces that friction lets pads hold, so a plate
whose every pair of such faces is farther apart than a gripper opens cannot be gripped. And nothing moves the plate
before a hand touches it where it lies. The first is asked of another solver as well.
"""

from __future__ import annotations

import itertools
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
from planners.geometry.pose import Array
from planners.plan.verdicts import Check

_ON_FACE = 1e-7
"""A vertex that is no deeper than this is on a face [m]."""
_WEIGHTLESS = 1e-12
"""Stands for no weight at all, so that shares of it are numbers [N]."""


def lift_infeasibility_check(evidence: Evidence, task: LiftTask) -> Check:
    """Check that a plan without a solution is proven to have none, and that its causes state the proof's numbers."""
    plan, shape = evidence.plan, task.plate.shape
    assert shape is not None
    plate, widths = plan.plate, face_distances(shape, task.stated.friction.grip)
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


def face_distances(shape: BodyShape, friction: float) -> tuple[float, float]:
    """Return thickness (along z), and how near to each other two sides of a prism are that pads can hold [m].

    Where its friction allows a pad to hold a side slantwise, sides whose normals are opposite within twice the angle
    of friction can be held, at the nearest where they are nearest; from 45 degrees on any two that meet.
    """
    (prism,) = shape.parts
    planes = [plane for plane in prism.planes if abs(plane[2]) < 0.5]
    sides = [_ends(plane, prism.vertices) for plane in planes]
    most = 2.0 * math.atan(friction)
    gaps = [
        min(_gap(one, other), _gap(other, one))
        for (plane, one), (opposite, other) in itertools.combinations(zip(planes, sides, strict=True), 2)
        if math.acos(np.clip(-float(plane[:2] @ opposite[:2]), -1.0, 1.0)) <= most
    ]
    return float(np.ptp(shape.vertices[:, 2])), min(gaps, default=math.inf)


def _ends(plane: Array, vertices: Array) -> Array:
    """Return the ends (2, 2) of a side seen from above."""
    along = vertices @ plane[:3]
    points = vertices[along > along.max() - _ON_FACE, :2]
    beside = points @ [-plane[1], plane[0]]
    return points[[np.argmin(beside), np.argmax(beside)]]


def _gap(side: Array, other: Array) -> float:
    """Return how near the ends of a side (2, 2) come to another side (2, 2) [m]."""
    begin, way = other[0], other[1] - other[0]
    share = np.clip((side - begin) @ way / (way @ way), 0.0, 1.0)
    return float(np.linalg.norm(side - begin - share[:, None] * way, axis=1).min())
