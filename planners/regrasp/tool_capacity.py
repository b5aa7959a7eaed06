"""What proves that no plan of a suction-tool task exists: weights and ways, in closed form and sound."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from planners.cell.arm_span import ArmSpan, out_of_reach
from planners.graph.rejections import CAPACITY, Rejection
from planners.regrasp.statics.hold_statics import OVERLOADED
from planners.regrasp.suction.suction_hold import CupStrength
from planners.scene.body import Body
from planners.scene.moved_object import MovedObject
from planners.scene.tool_scene import SuctionToolScene


def impossibilities(scene: SuctionToolScene, to_move: Sequence[MovedObject]) -> Iterator[Rejection]:
    """Yield the proofs that a task has no plan, each with what is needed and what there is.

    An object moves only while one hand alone holds the tool: where two do, nothing moves.

    Args:
        scene: the task.
        to_move: its objects that are not at their goals yet.
    """
    if not to_move:
        return
    heaviest = max(to_move, key=lambda each: each.body.mass or 0.0)
    gravity = float(np.linalg.norm(scene.cell.gravity))
    weight = gravity * (heaviest.body.mass or 0.0)
    lift = largest_lift(scene.tool.cup)
    if weight > lift:
        yield Rejection(CAPACITY, "The object is heavier than the cup bears.", heaviest.name, weight, lift, "N")
    weight += gravity * scene.tool.mass
    grip = largest_grip(scene.grip_force_limit, scene.friction.grip)
    if weight > grip:
        reason = "Tool and object are heavier than the fingers of a hand bear."
        yield Rejection(CAPACITY, reason, heaviest.name, weight, grip, "N")
    carry = max(scene.carry_force_limits.values())
    if weight > carry:
        yield Rejection(CAPACITY, OVERLOADED, heaviest.name, weight, carry, "N")
    yield from _out_of_reach(scene, to_move)


def _out_of_reach(scene: SuctionToolScene, to_move: Sequence[MovedObject]) -> Iterator[Rejection]:
    """Yield what no arm reaches: the tool with a hand, and objects and goals with the cup.

    Whatever symmetric turn an object ends in, no point of it is farther from its goal's origin than from its own.
    """
    spans = [ArmSpan.of(arm) for arm in scene.cell.arms.values()]
    tool = scene.tool
    length = _radius(tool.body)
    beyond = out_of_reach(spans, tool.T_world_tool[:3, 3], length)
    if beyond is not None:
        yield Rejection("reach", "No arm reaches the tool where it is.", "tool", beyond.needed, beyond.available, "m")
    for moved in to_move:
        places = {"where it is": moved.body.T_world_body, "at its goal": moved.T_world_goal_given}
        for where, T_world_object in places.items():
            beyond = out_of_reach(spans, T_world_object[:3, 3], length + _radius(moved.body))
            if beyond is not None:
                reason = f"No arm reaches the object {where}, with the tool."
                yield Rejection("reach", reason, moved.name, beyond.needed, beyond.available, "m")


def _radius(body: Body) -> float:
    """Return how far a body's farthest corner is from its origin [m]."""
    return float(np.linalg.norm(body.solid.surface()[0], axis=1).max())


def largest_lift(cup: CupStrength) -> float:
    """Return the greatest weight that a cup bears at any tilt [N].

    Tilted by t, a pull p and a shear s along the pad bear p cos t + s sin t, at most hypot(p, s); x and y each have
    sqrt(3) s <= mu (V - p), so that this is convex in p and greatest where p is V or 0.
    """
    return cup.max_force * max(1.0, math.sqrt(2.0 / 3.0) * cup.mu)


def largest_grip(normal: float, mu: float) -> float:
    """Return a bound of the net force of a hand whose fingers squeeze with at most `normal` [N].

    It bears friction of two fingers across the closing axis, and one normal force along it.
    """
    return normal * math.hypot(1.0, 2.0 * mu)
