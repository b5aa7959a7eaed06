"""The balance program (5) of paper B as printed, in cvxpy: slow, and the oracle of the solver.

Each contact has a full wrench [fx fy fz tx ty tz] in its own frame (z into the plate), of which (1) leaves some
entries zero. The cup's net pull f_s is outward, so that its wrench has fz = -f_s.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cvxpy as cp
import numpy as np

from planners.balance.cone_program import K_HAND, K_SUCTION
from planners.balance.contacts import Cup, Friction, GripContacts, HandLimits, PushContact, contact_axes
from planners.balance.lifter import lifter_of
from planners.contract.task_spec import LifterModel
from planners.geometry.pose import Array, Transform, inverse, transform
from planners.geometry.wrench import grasp_map


@dataclass(frozen=True, eq=False)
class Plate:
    """What is held: the data of (5) that stay the same over all poses and hands."""

    mass: float
    com: Array
    """(3,), plate frame [m]."""
    cup: Cup
    friction: Friction
    limits: HandLimits
    lifter_model: LifterModel
    gravity: float = 9.81


@dataclass(frozen=True, eq=False)
class Statement:
    """The program, and its unknowns."""

    problem: cp.Problem
    total: cp.Expression
    """G F of (5b): the wrench of all contacts together, (6,), plate axes, about the centre of mass."""
    limits: list[cp.Constraint]
    """(5c)-(5j) and the hard caps: all but the balance (5b)."""
    wrenches: dict[str, cp.Variable]
    """F_Λ of each contact, (6,), in the contact frame."""
    hand_effort: cp.Variable
    """f+_gp"""
    pull: cp.Variable
    """f_s"""

    @property
    def is_feasible(self) -> bool:
        """Whether the solved problem has a solution."""
        return self.problem.status in (cp.OPTIMAL, cp.OPTIMAL_INACCURATE)


def state_balance(
    plate: Plate,
    rotation_world_plate: Array,
    environment_points: Array,
    grip: GripContacts | None = None,
    push: PushContact | None = None,
) -> Statement:
    """Write (5a)-(5j) for one pose and hold; in the plate's axes, about its centre of mass."""
    up = np.asarray(rotation_world_plate, dtype=float)[2]
    frames = contact_frames(plate, up, environment_points, grip, push)
    F = {name: cp.Variable(6, name=name) for name in frames}
    f_plus_gp, f_plus_s = cp.Variable(name="f_plus_gp"), cp.Variable(name="f_plus_s")
    pull = cp.Variable(name="f_s")
    Omega_g = np.concatenate([-plate.mass * plate.gravity * up, np.zeros(3)])

    total: cp.Expression = cp.Constant(np.zeros(6))
    for name, T in frames.items():
        total = total + grasp_map(T) @ F[name]
    limits: list[cp.Constraint] = []
    for name in frames:
        if name.startswith("grip"):
            limits += _soft_finger(F[name], plate.friction.grip, plate.friction.eps)
        elif name == "push":
            limits += _point_contact(F[name], plate.friction.push)
        elif name.startswith("environment"):
            limits += _point_contact(F[name], plate.friction.environment)
    limits += _lifter(plate, F["cup"], pull, up)
    # (5h) and the hard caps
    limits += [pull >= 0, pull <= f_plus_s, f_plus_s <= plate.cup.max_force]
    # (5i) and the hard caps; (5j) is in the cones
    hands = [name for name in frames if name.startswith(("grip", "push"))]
    limits += [f_plus_gp >= 0, f_plus_gp <= plate.limits.normal]
    squeeze = plate.limits.squeeze
    limits += [F[name][2] <= f_plus_gp for name in hands if name == "push" or squeeze is None]
    for hand, most in (("grip", plate.limits.grip), ("push", plate.limits.push)):
        net = [frames[name][:3, :3] @ F[name][:3] for name in hands if name.startswith(hand)]
        limits += [cp.norm(sum(net)) <= most] if net else []
    if grip is not None and squeeze is not None:
        # The load of a squeezing gripper is its net force: one pad presses as much more as the other presses less.
        limits += [F["grip_0"][2] + F["grip_1"][2] == 2.0 * squeeze]
        limits += [cp.norm(sum(frames[name][:3, :3] @ F[name][:3] for name in ("grip_0", "grip_1"))) <= f_plus_gp]
    # (5a)
    objective = cp.Minimize(K_HAND * f_plus_gp + K_SUCTION * f_plus_s)
    # (5b)
    balance = total + Omega_g == 0
    return Statement(cp.Problem(objective, [balance, *limits]), total, limits, F, f_plus_gp, pull)


def solve_stated(problem: cp.Problem) -> float:
    """Solve a stated program; where the answer is called inaccurate, once more with data scaled with more care."""
    try:
        return float(problem.solve(solver="CLARABEL"))
    except UserWarning:
        return float(problem.solve(solver="CLARABEL", equilibrate_max_iter=50))


def contact_frames(
    plate: Plate, up: Array, environment_points: Array, grip: GripContacts | None, push: PushContact | None
) -> dict[str, Transform]:
    """Return the pose of each contact frame in plate axes, from the centre of mass."""
    T_com_plate = inverse(transform(position=plate.com))
    frames = {}
    if grip is not None:
        for finger, (point, normal) in enumerate(zip(grip.points, grip.normals, strict=True)):
            frames[f"grip_{finger}"] = transform(contact_axes(normal), point)
    if push is not None:
        frames["push"] = transform(contact_axes(push.normal), push.point)
    for index, point in enumerate(environment_points):
        frames[f"environment_{index}"] = transform(contact_axes(up), point)
    frames["cup"] = plate.cup.T_plate_cup
    return {name: T_com_plate @ T for name, T in frames.items()}


def _soft_finger(F: cp.Variable, mu: float, eps: float) -> list[cp.Constraint]:
    """(5c), and (1): no torque but about the normal."""
    return [cp.norm(cp.hstack([F[0], F[1], F[5] / eps])) <= mu * F[2], F[3:5] == 0]


def _point_contact(F: cp.Variable, mu: float) -> list[cp.Constraint]:
    """(5d), (5e), and (1): no torque."""
    return [cp.norm(F[:2]) <= mu * F[2], F[3:] == 0]


def _lifter(plate: Plate, F: cp.Variable, pull: cp.Variable, up: Array) -> list[cp.Constraint]:
    """(5f) and (5g), or another lifter's own limits."""
    cup = plate.cup
    lifter_of(plate.lifter_model, cup)
    if plate.lifter_model == "cable":
        return [F[:3] == pull * (cup.T_plate_cup[:3, :3].T @ up), F[3:] == 0]
    pressed = pull if plate.lifter_model == "paper" else cup.max_force - pull
    return [
        F[2] == -pull,
        math.sqrt(3) * cp.abs(F[:2]) <= cup.mu * pressed,
        math.sqrt(3) * cp.abs(F[5]) <= cup.radius * cup.mu * pressed,
        math.sqrt(2) * cp.abs(F[3:5]) <= math.pi * cup.radius * cup.kappa,
    ]
