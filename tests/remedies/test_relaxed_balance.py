"""Relaxed limits: what is told to be needed is enough, and less is not, as the balance program itself says."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from planners.balance.balanced import Balanced
from planners.balance.contacts import Cup
from planners.balance.lifter import LifterModel
from planners.remedies.relaxed_balance import relaxed
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
        more = relaxed(program).cup_force
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
        shift = relaxed(lift.balance.program(lift.rotation, NO_POINTS, lift.grip, lift.push)).cup_shift
        if shift is None or np.linalg.norm(shift) < 1e-4:
            continue
        asked += 1
        place = cup.T_plate_cup.copy()
        place[:2, 3] += 1.001 * np.array(shift)
        assert not balanced(lift, cup)
        assert balanced(lift, replace(cup, T_plate_cup=place))
    assert asked > 0
