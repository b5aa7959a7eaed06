"""How much of every limit can be kept back: against cvxpy, which knows nothing of steps."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import pytest

from planners.balance.balanced import Balanced
from planners.manipulation.statics.reserves import JOINTS, STEPS, ReserveScale
from tests.support.random_holds import Lift, random_lift

SEEDS = [(seed, model, points) for seed in range(8) for model, points in (("paper", 0), ("dexnet", 2), ("cable", 0))]


def keeping(lift: Lift, reserve: float) -> Lift:
    """The lift with all limits smaller by that share; the squeeze of a gripper is commanded."""
    plate, left = lift.plate, 1.0 - reserve
    cup, friction, limits = plate.cup, plate.friction, plate.limits
    smaller = replace(
        plate,
        cup=replace(cup, max_force=left * cup.max_force, mu=left * cup.mu, kappa=left * cup.kappa),
        friction=replace(
            friction,
            grip=left * friction.grip,
            push=left * friction.push,
            environment=left * friction.environment,
        ),
        limits=replace(limits, normal=left * limits.normal, grip=left * limits.grip, push=left * limits.push),
    )
    return replace(lift, plate=smaller)


def held_by_cvxpy(lift: Lift) -> bool:
    statement = lift.state()
    statement.problem.solve(solver="CLARABEL")
    return statement.is_feasible


@cache
def balanced() -> list[tuple[Lift, Balanced]]:
    """Return random lifts that are held, with how; those that are not are none."""
    lifts = [random_lift(seed, model, points, grip=True, push=True) for seed, model, points in SEEDS]
    return [(lift, answer) for lift in lifts if isinstance(answer := lift.solve(), Balanced)]


@pytest.mark.slow
def test_the_reserve_is_the_largest_whole_step_that_cvxpy_finds_forces_for() -> None:
    for lift, planned in balanced():
        scale = ReserveScale(lift.balance)
        reserve, forces = scale.forces_keeping_most(planned, 0.0)
        steps = round(reserve * STEPS)
        assert reserve == pytest.approx(steps / STEPS)
        assert held_by_cvxpy(keeping(lift, reserve))
        if steps + 1 < STEPS:
            assert not held_by_cvxpy(keeping(lift, (steps + 1) / STEPS))
        # The forces keep as much back as is said: they are within the smaller limits.
        smaller = keeping(lift, reserve).plate
        assert forces.suction_force <= smaller.cup.max_force + 1e-6
        assert forces.f_plus_gp <= smaller.limits.normal + 1e-6


def test_what_can_be_held_with_a_reserve_can_be_held_with_any_smaller_one() -> None:
    for lift, planned in balanced()[:6]:
        reserve, _ = ReserveScale(lift.balance).forces_keeping_most(planned, 0.0)
        for share in (0.0, 0.3, 0.7, 0.99):
            assert isinstance(keeping(lift, share * reserve).solve(), Balanced)


@pytest.mark.slow
def test_joints_are_named_where_forces_could_keep_more_back_and_nowhere_else() -> None:
    for lift, planned in balanced():
        scale = ReserveScale(lift.balance)
        reserve, _ = scale.forces_keeping_most(planned, 0.0)
        for steps in range(round(reserve * STEPS)):
            assert scale.limit(planned.held, steps / STEPS) == JOINTS
        assert scale.limit(planned.held, reserve) != JOINTS


def test_more_of_what_is_named_of_a_cup_would_do_and_dex_net_s_pull_is_named_only_where_friction_would_not() -> None:
    """Friction of Dex-Net's pad grows with the cup's force, so that more of that force is more of both."""
    for lift, planned in balanced():
        scale = ReserveScale(lift.balance)
        reserve, _ = scale.forces_keeping_most(planned, 0.0)
        beyond = keeping(lift, min((round(reserve * STEPS) + 1) / STEPS, 1.0 - 1.0 / STEPS))
        plate = beyond.plate
        rougher = replace(beyond, plate=replace(plate, cup=replace(plate.cup, mu=lift.plate.cup.mu)))
        stronger = replace(beyond, plate=replace(plate, cup=replace(plate.cup, max_force=lift.plate.cup.max_force)))
        named = scale.limit(planned.held, reserve)
        if named == "cup: friction":
            assert held_by_cvxpy(rougher)
        if named == "cup: pull":
            assert held_by_cvxpy(stronger)
            assert plate.lifter_model != "dexnet" or not held_by_cvxpy(rougher)


def test_forces_that_keep_as_much_as_there_can_be_stay_as_they_were_planned() -> None:
    lift, planned = balanced()[0]
    scale = ReserveScale(lift.balance)
    reserve, best = scale.forces_keeping_most(planned, 0.0)
    assert scale.forces_keeping_most(best, reserve) == (reserve, best)


def test_enough_random_lifts_are_held() -> None:
    reserves = [ReserveScale(lift.balance).forces_keeping_most(planned, 0.0)[0] for lift, planned in balanced()]
    assert len(reserves) >= 6
    assert max(reserves) - min(reserves) > 0.1
