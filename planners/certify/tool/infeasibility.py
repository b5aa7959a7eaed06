"""What proves that a suction-tool task has no plan, derived again from the task.

An object that is moved hangs on the cup, whose wrench bears its weight at least where it is lifted; and with it the
tool hangs in one hand: where two hold it, nothing moves. A tool whose every convex part is wider than a gripper opens
cannot be gripped. And a hand has to reach the tool where it is, and with the tool every object that is not at its goal,
at the start and at the goal: a point of the tool is between its pads, and the cup's lip, its origin, on the object.
"""

from __future__ import annotations

import math
from functools import partial

import numpy as np

from planners.certify.common.cones import StatedCup
from planners.certify.common.infeasibility import Bound, body_radius, proof_check, reach_bound
from planners.certify.common.lift_capacity import largest_lift, stated_lift
from planners.certify.geometry.body_shape import ConvexPart
from planners.certify.plan_view import PlanView
from planners.certify.settings import CertifySettings
from planners.certify.tool.goals import goal_margin, nearest_turn
from planners.certify.tool.task import TOOL, StatedObject, ToolTask
from planners.geometry.pose import inverse
from planners.plan.verdicts import Check

_WEIGHTLESS = 1e-12
"""Stands for no mass at all, so that shares of it are numbers [kg]."""


def tool_infeasibility_check(plan: PlanView, task: ToolTask, settings: CertifySettings) -> Check:
    """Check that a plan without a solution is proven to have none, and that its causes state the proof's numbers."""
    forces = [finger_bound(plan, task, settings), carry_bound(plan, task, settings)]
    if task.tool is not None:
        forces.append(cup_bound(plan, task, task.tool.cup, settings))
    lengths = [tool_opening_bound(plan), *reach_bounds(plan, task, settings)]
    return proof_check(plan, {"N": forces, "m": lengths}, settings)


def _to_move(plan: PlanView, task: ToolTask, settings: CertifySettings) -> list[StatedObject]:
    """Return the objects that are not at their goals at the start."""
    found = []
    for stated in task.objects:
        T = inverse(stated.T_world_goal) @ stated.body.T_world_body
        shape = plan.bodies[stated.body.name].shape
        if goal_margin(T, nearest_turn(T, stated, shape.vertices), settings) < 0.0:
            found.append(stated)
    return found


def _heaviest(plan: PlanView, task: ToolTask, settings: CertifySettings) -> float:
    """Return the mass of the heaviest object that is not at its goal at the start [kg]."""
    return max([_WEIGHTLESS, *(stated.body.mass or 0.0 for stated in _to_move(plan, task, settings))])


def reach_bounds(plan: PlanView, task: ToolTask, settings: CertifySettings) -> list[Bound]:
    """Return how far tool, objects and goals are from a shoulder, and how far its arm reaches with the tool [m].

    Whatever symmetric turn an object ends in, it is within its radius about the goal: a turn about its axis keeps the
    distance from the origin, and one that takes the shape to itself the room that it takes.
    """
    to_move = _to_move(plan, task, settings)
    tool = plan.bodies[TOOL]
    length = body_radius(tool)
    bounds = [reach_bound(plan, tool.T_world_start[:3, 3], length)] if to_move else []
    for stated in to_move:
        body = plan.bodies[stated.body.name]
        places = body.T_world_start[:3, 3], stated.T_world_goal[:3, 3]
        bounds += [reach_bound(plan, place, length + body_radius(body)) for place in places]
    return bounds


def cup_bound(plan: PlanView, task: ToolTask, cup: StatedCup, settings: CertifySettings) -> Bound:
    """Return the weight of the heaviest object that has to move, and the most that the cup bears [N]."""
    weight = float(np.linalg.norm(plan.gravity)) * _heaviest(plan, task, settings)
    return Bound(weight, (weight,), largest_lift(cup, "dexnet"), partial(stated_lift, cup, "dexnet", ()))


def finger_bound(plan: PlanView, task: ToolTask, settings: CertifySettings) -> Bound:
    """Return the weight of tool and heaviest object, and the most that the fingers of a hand bear [N].

    Two fingers bear at most their friction across the closing axis, and one normal force along it.
    """
    weight = _laden_weight(plan, task, settings)
    return Bound(weight, (weight,), task.grip_force_limit * math.hypot(1.0, 2.0 * task.grip_friction))


def carry_bound(plan: PlanView, task: ToolTask, settings: CertifySettings) -> Bound:
    """Return the weight of tool and heaviest object, and the most that a hand may carry [N]."""
    weight = _laden_weight(plan, task, settings)
    return Bound(weight, (weight,), max(task.carry_limits(plan).values()))


def _laden_weight(plan: PlanView, task: ToolTask, settings: CertifySettings) -> float:
    mass = _heaviest(plan, task, settings) + (plan.bodies[TOOL].mass or 0.0)
    return float(np.linalg.norm(plan.gravity)) * mass


def tool_opening_bound(plan: PlanView) -> Bound:
    """Return the narrowest width of any part of the tool, and how far a gripper opens [m]."""
    narrowest = min(_width(part) for part in plan.bodies[TOOL].shape.parts)
    open_widths = [float(hand.tcp_table[-1, 0]) for hand in plan.hands.values() if hand.tcp_table is not None]
    return Bound(narrowest, (narrowest,), max(open_widths, default=0.0))


def _width(part: ConvexPart) -> float:
    """Return the least width of a convex part: square to a face, or to an edge of each of two sides."""
    first, second = np.triu_indices(len(part.edges), 1)
    crosses = np.cross(part.edges[first], part.edges[second])
    lengths = np.linalg.norm(crosses, axis=1)
    directions = np.vstack([part.planes[:, :3], crosses[lengths > 1e-6] / lengths[lengths > 1e-6, None]])
    return float(np.ptp(part.vertices @ directions.T, axis=0).min())
