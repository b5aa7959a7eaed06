"""Random plate lifts: any size, friction, limits and hands, standing on a face, an edge, a vertex or nothing."""

from __future__ import annotations

from dataclasses import dataclass

import cvxpy as cp
import numpy as np

from planners.balance.balanced import Balanced, Unbalanced
from planners.balance.contacts import Cup, Friction, GripContacts, HandLimits, PushContact
from planners.balance.solver import Balance
from planners.contract.task_spec import LifterModel
from planners.geometry.pose import Array, rotation_x, rotation_y, rotation_z
from tests.support.balance_statement import Plate, Statement, state_balance


@dataclass(frozen=True, eq=False)
class Lift:
    """One node of a plate lift, to be solved either way."""

    plate: Plate
    half: Array
    rotation: Array
    environment_points: Array
    grip: GripContacts | None
    push: PushContact | None

    @property
    def balance(self) -> Balance:
        p = self.plate
        return Balance(p.mass, p.com, p.cup, p.friction, p.limits, p.lifter_model)

    def solve(self) -> Balanced | Unbalanced:
        return self.balance.solve(self.rotation, self.environment_points, self.grip, self.push)

    def state(self) -> Statement:
        return state_balance(self.plate, self.rotation, self.environment_points, self.grip, self.push)

    def most_power(self, statement: Statement, twist: Array) -> float:
        """Ask cvxpy for the most power of the contacts and the weight along `twist` [W]."""
        normals = [F[2] for name, F in statement.wrenches.items() if name.startswith("environment")]
        bound = [cp.sum(cp.hstack(normals)) <= self.balance.environment_bound] if normals else []
        problem = cp.Problem(cp.Maximize(twist @ statement.total), [*statement.limits, *bound])
        return problem.solve(solver="CLARABEL") - self.plate.mass * 9.81 * twist[:3] @ self.rotation[2]


def _tilted(rng: np.random.Generator, environment: int) -> Array:
    level = rotation_z(rng.uniform(-np.pi, np.pi))
    tilt = np.deg2rad(rng.uniform(4.0, 40.0))
    if environment == 4:
        return level
    if environment == 2:
        return level @ rotation_y(tilt)
    azimuth = rng.uniform(-np.pi, np.pi)
    return level @ rotation_z(azimuth) @ rotation_x(tilt) @ rotation_z(-azimuth)


def random_grip(rng: np.random.Generator, half: Array) -> GripContacts:
    side = int(rng.integers(2))
    point = rng.uniform(-half, half)
    point[side] = np.sign(point[side]) * (half[side] - 0.018)
    points = np.array([point, point])
    points[:, 2] = -half[2], half[2]
    slant = 0.2 * rng.standard_normal((2, 3)) * (rng.random() < 0.3)
    normals = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]]) + slant
    return GripContacts(points, normals / np.linalg.norm(normals, axis=1, keepdims=True))


def random_push(rng: np.random.Generator, half: Array) -> PushContact:
    point = rng.uniform(-half, half)
    face = int(rng.integers(3))
    outside = np.zeros(3)
    outside[face] = -1.0 if face == 2 else np.sign(point[face])
    point[face] = outside[face] * half[face]
    return PushContact(point, -outside)


def random_lift(seed: int, model: LifterModel, environment: int, grip: bool, push: bool) -> Lift:
    rng = np.random.default_rng([seed, environment, grip, push])
    half = np.array([*rng.uniform(0.12, 0.27, 2), 0.021])
    radius = rng.uniform(0.012, 0.03)
    position = (*rng.uniform(-0.1, 0.1, 2), half[2])
    cup = Cup.on_top(position, radius, rng.uniform(15.0, 80.0), mu=rng.uniform(0.2, 0.8), kappa=rng.choice([0.005, 9]))
    plate = Plate(
        mass=rng.uniform(1.0, 6.0),
        com=rng.uniform(-0.02, 0.02, 3),
        cup=cup,
        friction=Friction(*rng.uniform(0.3, 0.8, 3), eps=rng.uniform(0.004, 0.02)),
        limits=HandLimits(
            rng.uniform(10.0, 25.0), rng.uniform(8.0, 30.0), rng.uniform(8.0, 30.0), rng.choice([None, 20.0, 60.0])
        ),
        lifter_model=model,
    )
    corners = half * np.array([[-1, -1, -1], [-1, 1, -1], [1, 1, -1], [1, -1, -1]])
    grip_contacts, push_contact = random_grip(rng, half), random_push(rng, half)
    return Lift(
        plate,
        half,
        _tilted(rng, environment),
        corners[:environment],
        grip_contacts if grip else None,
        push_contact if push else None,
    )
