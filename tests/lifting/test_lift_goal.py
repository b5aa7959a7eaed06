"""F_goal of eq. (11): as far from every limit as there can be, one kind of limit after the other, as cvxpy says."""

from __future__ import annotations

from collections.abc import Iterator

import cvxpy as cp
import numpy as np
import pytest

from planners.balance.cone_program import ConeProgram
from planners.balance.contacts import GripContacts, PushContact
from planners.balance.solver import Balance
from planners.geometry.pose import Array
from planners.lifting.lift_goal import RESERVES, LiftGoal, lift_goal
from planners.manipulation.statics.lift_programs import keeping_back
from tests.support.random_holds import Lift, random_lift

IN_THE_AIR = np.empty((0, 3))
STEP = RESERVES[0] - RESERVES[1]
CASES = 40


class Hanging:
    """A random plate in both hands and on the cup, and its goal."""

    def __init__(self, lift: Lift) -> None:
        assert lift.grip is not None
        assert lift.push is not None
        self.stated: Balance = lift.balance
        self.rotation: Array = lift.rotation
        self.grip: GripContacts = lift.grip
        self.push: PushContact = lift.push
        self.goal: LiftGoal | None = lift_goal(self.stated, self.rotation, self.grip, self.push)

    def largest_push(self, cup_reserve: float, reserve: float) -> float | None:
        """Return the largest normal force of the stick with so much kept back [N]; None: the plate is not held."""
        program = keeping_back(self.stated, cup_reserve, reserve)
        fingers = 8 if self.stated.limits.squeeze is None else 7
        return _most(program.program(self.rotation, IN_THE_AIR, self.grip, self.push), fingers + 2)


def _most(program: ConeProgram, index: int) -> float | None:
    x = cp.Variable(program.balance.shape[1])
    slack = program.rows @ x + program.offsets
    linear, *orders = program.sizes
    constraints = [program.balance @ x == program.load, slack[:linear] >= 0.0]
    begin = linear
    for order in orders:
        constraints.append(cp.SOC(slack[begin], slack[begin + 1 : begin + order]))
        begin += order
    problem = cp.Problem(cp.Maximize(x[index]), constraints)
    # A border case does not get to the last digits; a millinewton is enough here.
    problem.solve(solver=cp.CLARABEL, tol_gap_abs=1e-6, tol_gap_rel=1e-6, tol_feas=1e-7)
    return None if x.value is None else float(x.value[index])


@pytest.fixture(scope="module")
def hanging() -> list[Hanging]:
    return [Hanging(random_lift(seed, "paper", 0, True, True)) for seed in range(CASES)]


def goals(hanging: list[Hanging]) -> Iterator[tuple[Hanging, LiftGoal]]:
    return ((plate, plate.goal) for plate in hanging if plate.goal is not None)


def test_there_is_no_goal_only_where_nothing_bears_the_plate(hanging: list[Hanging]) -> None:
    borne = [plate.largest_push(0.0, 0.0) is not None for plate in hanging]
    assert borne == [plate.goal is not None for plate in hanging]
    assert 0 < sum(borne) < CASES


def test_no_percent_more_can_be_kept_back(hanging: list[Hanging]) -> None:
    for plate, goal in goals(hanging):
        if goal.cup_reserve < RESERVES[0]:
            assert plate.largest_push(goal.cup_reserve + STEP, 0.0) is None
        if goal.reserve < goal.cup_reserve:
            assert plate.largest_push(goal.cup_reserve, goal.reserve + STEP) is None


def test_the_stick_presses_as_far_from_nothing_as_what_is_kept_back_allows(hanging: list[Hanging]) -> None:
    raised = 0
    for plate, goal in goals(hanging):
        range_of_push = plate.stated.limits.pushing
        pressed = goal.balance.wrenches_contact[goal.balance.contacts.index("push"), 2]
        assert pressed >= goal.push_share * range_of_push - 1e-9
        most = plate.largest_push(goal.cup_reserve, goal.reserve)
        assert most is not None
        if goal.push_share < RESERVES[0]:
            assert most < (goal.push_share + STEP) * range_of_push + 1e-3
        raised += goal.push_share > 0.0
    assert raised > 0
