"""Relaxed limits: what is told to be needed is enough, and less is not, as the balance program itself says."""

from __future__ import annotations

from dataclasses import replace

import cvxpy as cp
import numpy as np
import pytest

from planners.balance.balanced import Balanced
from planners.balance.cone_program import TORQUE_LENGTH, ConeProgram
from planners.balance.contacts import Cup
from planners.balance.lifter import LifterModel
from planners.balance.relaxed_balance import least_force, least_shift
from planners.geometry.pose import Array
from tests.support.random_holds import Lift, random_lift

NO_POINTS = np.empty((0, 3))


def balanced(lift: Lift, cup: Cup) -> bool:
    plate = replace(lift.plate, cup=cup)
    return isinstance(replace(lift, plate=plate).solve(), Balanced)


@pytest.mark.parametrize("model", ["paper", "cable"])
def test_so_much_more_force_of_the_cup_holds_the_plate_and_less_does_not(model: LifterModel) -> None:
    asked = 0
    for seed in range(60):
        lift = random_lift(seed, model, seed % 3, True, True)
        cup = lift.plate.cup
        program = lift.balance.program(lift.rotation, lift.environment_points, lift.grip, lift.push)
        more = least_force(program)
        if more is None or more < 1e-3:
            continue
        assert not balanced(lift, cup)
        asked += 1
        assert balanced(lift, replace(cup, max_force=cup.max_force + 1.01 * more))
        assert not balanced(lift, replace(cup, max_force=cup.max_force + 0.98 * more))
    assert asked > 0


def test_a_cable_moved_to_the_told_place_holds_a_level_plate() -> None:
    """Level, the cable pulls square to the plate, and its moment is all that its place changes."""
    asked = 0
    for seed in range(40):
        lift = replace(random_lift(seed, "cable", 0, True, True), rotation=np.eye(3), environment_points=NO_POINTS)
        cup = lift.plate.cup
        shift = least_shift(lift.balance.program(lift.rotation, NO_POINTS, lift.grip, lift.push))
        if shift is None or np.linalg.norm(shift) < 1e-4:
            continue
        asked += 1
        place = cup.T_plate_cup.copy()
        place[:2, 3] += 1.001 * np.array(shift)
        assert not balanced(lift, cup)
        assert balanced(lift, replace(cup, T_plate_cup=place))
    assert asked > 0


def within(program: ConeProgram, x: cp.Variable, more: cp.Expression | Array) -> list[cp.Constraint]:
    """Return (5c)-(5j) with so much more (m,) of every limit."""
    value = program.rows @ x + program.offsets + more
    linear, *cones = np.split(np.arange(len(program.offsets)), np.cumsum(program.sizes)[:-1])
    limits: list[cp.Constraint] = [value[linear] >= 0.0]
    return limits + [cp.SOC(value[cone[0]], value[cone[1:]]) for cone in cones]


def stated_force(program: ConeProgram) -> float | None:
    more, x = cp.Variable(nonneg=True), cp.Variable(program.balance.shape[1])
    bounds_the_pull = (program.rows != 0.0).sum(axis=1) == 1
    bounds_the_pull &= program.rows[:, program.pull] == -1.0
    limits = within(program, x, more * bounds_the_pull.astype(float))
    problem = cp.Problem(cp.Minimize(more), [program.balance @ x == program.load, *limits])
    problem.solve(solver=cp.CLARABEL)
    return None if more.value is None else float(more.value)


def stated_moment(program: ConeProgram) -> float | None:
    """Return the least moment about the two axes in the plate's plane with which it is held [Nm]."""
    moment, x = cp.Variable(2), cp.Variable(program.balance.shape[1])
    about = np.zeros((6, 2))
    about[3, 0] = about[4, 1] = 1.0 / TORQUE_LENGTH
    held = [program.balance @ x + about @ moment == program.load, *within(program, x, np.zeros(len(program.offsets)))]
    problem = cp.Problem(cp.Minimize(cp.norm(moment)), held)
    problem.solve(solver=cp.CLARABEL)
    return None if moment.value is None else float(np.linalg.norm(moment.value))


@pytest.mark.parametrize("model", ["paper", "cable"])
@pytest.mark.slow
def test_force_and_shift_are_those_of_the_program_as_cvxpy_states_it(model: LifterModel) -> None:
    asked = 0
    for seed in range(30):
        lift = random_lift(seed, model, seed % 3, True, True)
        program = lift.balance.program(lift.rotation, lift.environment_points, lift.grip, lift.push)
        least, shift = least_force(program), least_shift(program)
        force, moment = stated_force(program), stated_moment(program)
        assert (least is None) == (force is None)
        assert shift is None or moment is not None
        if least is not None and force is not None:
            assert least == pytest.approx(force, rel=1e-5, abs=1e-5)
        if shift is not None and moment is not None:
            # The place that is told is the moment over the pull, which no limit of the cup lets be larger than this.
            pulls = lift.plate.cup.max_force
            assert np.linalg.norm(shift) >= moment / pulls * (1.0 - 1e-4) - 1e-6
            asked += moment > 1e-3
    assert asked > 0
