"""What proves that a suction-tool task has no plan, derived again from the task.

An object that is moved hangs on the cup, whose wrench bears its weight at least where it is lifted; and with it the
tool hangs in one hand: where two hold it, nothing moves. And a hand has to reach the tool where it is, and with the
tool every object that is not at its goal, at the start and at the goal: a point of the tool is between its pads, and
the cup's lip, its origin, on the object.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
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
from planners.certify.tool.goals import goal_margins
from planners.certify.tool.task import TOOL, StatedObject, ToolTask
from planners.plan.verdicts import Check

_WEIGHTLESS = 1e-12
"""Stands for no mass at all, so that shares of it are numbers [kg]."""


def tool_infeasibility_check(evidence: Evidence, task: ToolTask) -> Check:
    """Check that a plan without a solution is proven to have none, and that its causes state the proof's numbers.

    Two fingers bear at most their friction across the closing axis, and one normal force along it.
    """
    plan, tool = evidence.plan, evidence.plan.bodies[TOOL]
    to_move = [each for each in task.objects if min(goal_margins(evidence, each, each.body.T_world_body)) < 0.0]
    gravity = float(np.linalg.norm(plan.cell.gravity))
    heaviest = max([_WEIGHTLESS, *(each.body.mass or 0.0 for each in to_move)])
    laden, weight = gravity * (heaviest + (tool.mass or 0.0)), gravity * heaviest
    pinched = task.stated.grip_force_limit * math.hypot(1.0, 2.0 * task.stated.friction.grip)
    forces = [Bound(laden, (laden,), pinched), Bound(laden, (laden,), max(task.carry_limits(plan).values()))]
    if task.tool is not None:
        cup = task.tool.cup
        second = partial(stated_lift, cup, "dexnet", ())
        forces.append(Bound(weight, (weight,), largest_lift(cup, "dexnet"), second))
    return proof_check(evidence, {"N": forces, "m": _reach_bounds(evidence, to_move)})


def _reach_bounds(evidence: Evidence, to_move: Sequence[StatedObject]) -> list[Bound]:
    """Return how far tool, objects and goals are from a shoulder, and how far its arm reaches with the tool [m].

    Whatever symmetric turn an object ends in, it is within its radius about the goal: a turn about its axis keeps the
    distance from the origin, and one that takes the shape to itself the room that it takes.
    """
    plan = evidence.plan
    tool = plan.bodies[TOOL]
    length = body_radius(tool)
    bounds = [reach_bound(evidence, tool.T_world_start[:3, 3], length)] if to_move else []
    for stated in to_move:
        body = plan.bodies[stated.body.name]
        places = body.T_world_start[:3, 3], stated.T_world_goal[:3, 3]
        bounds += [reach_bound(evidence, place, length + body_radius(body)) for place in places]
    return bounds
