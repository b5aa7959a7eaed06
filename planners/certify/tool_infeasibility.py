"""What proves that a suction-tool task has no plan, derived again from the task.

An object that is moved hangs on the cup, whose wrench bears its weight at least where it is lifted; and with it the
tool hangs in one hand or in two. A tool whose every convex part is wider than a gripper opens cannot be gripped.
"""

from __future__ import annotations

import math

import numpy as np

from planners.certify.body_shape import ConvexPart
from planners.certify.certificate import Check
from planners.certify.document_view import PlanView
from planners.certify.infeasibility import Bound, check_bounds, largest_lift
from planners.certify.settings import CertifySettings
from planners.certify.tool_task import TOOL, ToolTask


def tool_infeasibility_check(plan: PlanView, task: ToolTask, settings: CertifySettings) -> Check:
    """Check that a plan without a solution is proven to have none, and that its causes state the proof's numbers."""
    bounds = {"m": [opening_bound(plan)], "N": [hand_bound(plan, task)]}
    if task.tool is not None:
        bounds["N"].append(cup_bound(plan, task))
    return check_bounds(plan, bounds, settings)


def _weights(plan: PlanView, task: ToolTask) -> tuple[float, ...]:
    gravity = float(np.linalg.norm(plan.gravity))
    return tuple(gravity * (stated.body.mass or 0.0) for stated in task.objects if moves(stated))


def cup_bound(plan: PlanView, task: ToolTask) -> Bound:
    """Return the weight of the heaviest object that has to move, and the most that the cup bears [N]."""
    assert task.tool is not None
    weights = _weights(plan, task)
    return Bound(max(weights), weights, largest_lift(task.tool.cup, "dexnet"))
