"""The closed-form capacity is an upper bound of what any hold lifts, and is reached."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import get_args

import cvxpy as cp
import numpy as np
import pytest

from planners.balance.balanced import Unbalanced
from planners.balance.contacts import Cup, Friction, HandLimits, PushContact
from planners.balance.solver import Balance
from planners.contract.task_spec import LifterModel
from planners.geometry.pose import rotation_x, rotation_y, rotation_z
from tests.support.balance_statement import Plate, state_balance

MODELS = get_args(LifterModel)
MAX_TILT = math.radians(40.0)


def most_lift(statement, up) -> float:
    problem = cp.Problem(cp.Maximize(up @ statement.total[:3]), statement.limits)
    return float(problem.solve(solver="CLARABEL"))


@pytest.mark.parametrize("model", MODELS)
def test_no_hold_lifts_more_than_the_capacity(random_lift, model):
    for seed in range(12):
        lift = random_lift(seed, model, 0, True, True)
        assert most_lift(lift.state(), lift.rotation[2]) <= lift.balance.capacity(MAX_TILT).available + 1e-5


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("max_tilt", [0.0, 0.2, MAX_TILT])
def test_the_cups_share_is_reached_at_some_tilt(model, max_tilt):
    cup = Cup.on_top((0.0, 0.0, 0.02), 0.0175, 20.0, mu=0.6)
    plate = Plate(4.0, np.zeros(3), cup, Friction(), HandLimits(), model)
    expected = Balance(4.0, np.zeros(3), cup, lifter_model=model).capacity(max_tilt).cup
    lifts = []
    for tilt in np.linspace(0.0, max_tilt, 25):
        # The pad's friction is largest at 45 degrees to its axes.
        R = rotation_z(0.3) @ rotation_x(tilt) @ rotation_z(math.pi / 4)
        lifts.append(most_lift(state_balance(plate, R, np.empty((0, 3))), R[2]))
    assert max(lifts) <= expected + 1e-5
    assert max(lifts) == pytest.approx(expected, rel=1e-3)


def test_the_pushers_share_is_reached_along_the_edge_of_its_cone():
    limits, friction = HandLimits(17.0, 100.0, 100.0), Friction(push=0.5)
    held = Balance(4.0, np.zeros(3), Cup.on_top((0, 0, 0.02), 0.0175, 0.0), friction, limits)
    plate = Plate(4.0, np.zeros(3), held.cup, friction, limits, "paper")
    R = rotation_y(math.atan(0.5))
    push = PushContact(np.array([0.0, 0.1, -0.02]), np.array([0.0, 0.0, 1.0]))
    statement = state_balance(plate, R, np.empty((0, 3)), None, push)
    assert most_lift(statement, R[2]) == pytest.approx(held.capacity(MAX_TILT).pusher, rel=1e-6)


@pytest.mark.parametrize("model", MODELS)
def test_the_weak_cup_cannot_lift_the_heavy_plate(model):
    """Paper B, PB with the 20 N cup: 62.8 N against the cup, a gripper of 17 N and a stick of 19 N."""
    cup = Cup.on_top((0.045, 0.0, 0.022), 0.0175, 20.0)
    capacity = Balance(6.4, np.zeros(3), cup, lifter_model=model).capacity(MAX_TILT)
    assert not capacity.suffices
    assert capacity.needed == pytest.approx(62.784)
    assert (capacity.gripper, capacity.pusher) == (17.0, 19.0)
    strong = Balance(6.4, np.zeros(3), replace(cup, max_force=60.0), lifter_model=model).capacity(MAX_TILT)
    assert strong.suffices


@pytest.mark.parametrize("model", MODELS)
def test_what_exceeds_the_capacity_is_refused_at_every_pose_off_the_table(random_lift, model):
    for seed in range(10):
        lift = random_lift(seed, model, 0, True, True)
        too_heavy = 1.0001 * lift.balance.capacity(MAX_TILT).available / 9.81
        heavy = replace(lift, plate=replace(lift.plate, mass=too_heavy))
        assert not heavy.balance.capacity(MAX_TILT).suffices
        assert isinstance(heavy.solve(), Unbalanced)
