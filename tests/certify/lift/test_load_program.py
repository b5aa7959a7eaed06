"""How much heavier a plate could be: the certificate's program against cvxpy, and against the planners' own."""

from __future__ import annotations

import math

import numpy as np
import pytest
from pydantic import TypeAdapter

from planners.balance.balanced import Balanced
from planners.certify.lift.load_program import LARGEST_FACTOR, ContactBounds, LoadProgram, stated_factors
from planners.contract.task_spec import LifterModel
from planners.geometry.pose import Array
from planners.plan.contacts import BearingContact, Contact
from tests.support.random_holds import Lift, random_lift

KNOWN = TypeAdapter(Contact)
KINDS = [
    (model, points, hands) for model in ("paper", "dexnet", "cable") for points in (0, 1, 2) for hands in (0, 1, 2, 3)
]


def contacts_of(lift: Lift) -> list[BearingContact]:
    """The contacts of a lift as a document states them; what they exert is not read."""
    plate, R = lift.plate, lift.rotation
    friction, limits, found = plate.friction, plate.limits, []

    def add(
        by: str, kind: str, point: Array, normal: Array, x_axis: Array | None = None, **values: float | None
    ) -> None:
        finger, axes = len(found) if kind == "soft_finger" else None, {} if x_axis is None else {"x_axis": R @ x_axis}
        place = {"body": "plate", "by": by, "finger": finger, "point": R @ point, "normal": R @ normal}
        found.append(
            KNOWN.validate_python({"kind": kind, "sample": 0, "wrench": np.zeros(6), **place, **axes, **values})
        )

    if lift.grip is not None:
        for point, normal in zip(lift.grip.points, lift.grip.normals, strict=True):
            values = {"mu": friction.grip, "eps": friction.eps, "limit": limits.finger, "squeeze": limits.squeeze}
            add("right", "soft_finger", point, normal, **values)
    if lift.push is not None:
        add("left", "point", lift.push.point, lift.push.normal, mu=friction.push, limit=limits.pushing)
    for point in lift.environment_points:
        add("table", "environment", point, R[2], mu=friction.environment, limit=None)
    cup = plate.cup
    T, values = cup.T_plate_cup, {"mu": cup.mu, "radius": cup.radius, "kappa": cup.kappa, "limit": cup.max_force}
    add("cup", "suction", T[:3, 3], T[:3, 2], T[:3, 0], suction_force=0.0, **values)
    return found


def bounds_of(lift: Lift) -> ContactBounds:
    limits = lift.plate.limits
    gripper = limits.grip if limits.squeeze is None else min(limits.grip, limits.normal)
    return ContactBounds({"right": gripper, "left": limits.push}, lift.plate.lifter_model)


def loads_of(lift: Lift, rng: np.random.Generator) -> list[Array]:
    """The weight, and wrenches like it."""
    weight = np.array([0.0, 0.0, -9.81 * lift.plate.mass])
    others = [weight + 3.0 * rng.standard_normal(3) for _ in range(2)]
    return [np.concatenate([force, np.cross(0.01 * rng.standard_normal(3), force)]) for force in others] + [
        np.concatenate([weight, np.zeros(3)])
    ]


@pytest.mark.parametrize("kind", KINDS)
def test_both_programs_find_the_same_factors(kind: tuple[str, int, int]) -> None:
    model, points, hands = kind
    rng = np.random.default_rng(points)
    for seed in (1, 2):
        lift = random_lift(seed, model, points, bool(hands & 1), bool(hands & 2))
        contacts, centre, bounds = contacts_of(lift), lift.rotation @ lift.plate.com, bounds_of(lift)
        loads = loads_of(lift, rng)
        program = LoadProgram(contacts, centre, bounds)
        stated = stated_factors(contacts, centre, bounds, loads)
        # A squeeze of fingers that are not opposite may be more than the contacts bear without any load.
        for load, factor in zip(loads, stated, strict=True):
            found = program.factor(load)
            assert math.isnan(found) == math.isnan(factor)
            assert math.isnan(found) or found == pytest.approx(factor, abs=2e-6)


@pytest.mark.parametrize("model", ["paper", "dexnet", "cable"])
@pytest.mark.parametrize("points", [1, 2])
def test_at_a_rim_both_programs_find_the_same_and_bear_what_the_planners_hold(model: LifterModel, points: int) -> None:
    """The planners keep to one round cone within those of both edges, so that what they do not hold may be borne."""
    rng, factors = np.random.default_rng(points), []
    for seed in range(8):
        lift = random_lift(seed, model, points, grip=True, push=True)
        contacts, centre, bounds = contacts_of(lift), lift.rotation @ lift.plate.com, bounds_of(lift)
        bottom = lift.rotation[:, 2]
        beyond = {number: bottom for number, each in enumerate(contacts) if each.kind == "environment"}
        loads = loads_of(lift, rng)
        program, elsewhere = LoadProgram(contacts, centre, bounds, beyond), LoadProgram(contacts, centre, bounds)
        found = [program.factor(load) for load in loads]
        assert found == pytest.approx(stated_factors(contacts, centre, bounds, loads, beyond), abs=2e-6, nan_ok=True)
        factors += [(factor, elsewhere.factor(load)) for factor, load in zip(found, loads, strict=True)]
        balance = lift.balance.with_rim(lift.environment_points[:, :2])
        if isinstance(balance.solve(lift.rotation, lift.environment_points, lift.grip, lift.push), Balanced):
            assert found[-1] >= 1.0 - 1e-5
    at_rim, not_there = np.array(factors).T
    assert not (at_rim > not_there + 1e-5).any()
    assert (at_rim < not_there - 1e-3).any()


@pytest.mark.parametrize("kind", KINDS)
def test_the_weight_is_borne_once_where_the_planners_find_a_balance(kind: tuple[str, int, int]) -> None:
    """They share no kernel."""
    model, points, hands = kind
    for seed in range(12):
        lift = random_lift(seed, model, points, bool(hands & 1), bool(hands & 2))
        program = LoadProgram(contacts_of(lift), lift.rotation @ lift.plate.com, bounds_of(lift))
        factor = program.factor(np.array([0.0, 0.0, -9.81 * lift.plate.mass, 0.0, 0.0, 0.0]))
        held = isinstance(lift.solve(), Balanced)
        assert factor >= 1.0 - 1e-5 if held else not factor >= 1.0 + 1e-5, factor


def test_random_lifts_are_borne_and_not_borne() -> None:
    factors = []
    for seed in range(12):
        lift = random_lift(seed, "paper", 0, grip=True, push=True)
        program = LoadProgram(contacts_of(lift), lift.rotation @ lift.plate.com, bounds_of(lift))
        factors.append(program.factor(np.array([0.0, 0.0, -9.81 * lift.plate.mass, 0.0, 0.0, 0.0])))
    assert sum(factor > 1.0 for factor in factors) > 2
    assert sum(not factor > 1.0 for factor in factors) > 2
    assert np.nanmax(factors) <= LARGEST_FACTOR + 1e-6
