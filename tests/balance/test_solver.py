"""The compiled solver against the paper's statement in cvxpy, and its answers against the contract's limits."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import product
from typing import get_args

import numpy as np
import pytest

from planners.balance.balanced import Balanced, Unbalanced, UnbalanceReason
from planners.balance.cone_program import Manner, Template
from planners.balance.contacts import Cup, Friction, HandLimits
from planners.balance.solver import Balance
from planners.contract.task_spec import LifterModel
from tests.support.balance_statement import solve_stated
from tests.support.samples import sample

STRUCTURES = list(product(get_args(LifterModel), (0, 1, 2, 4), (False, True), (False, True)))
SEEDS = sample(range(2), range(5))


@pytest.fixture(scope="module")
def solved(random_lift):
    lifts = [random_lift(seed, *structure) for structure in STRUCTURES for seed in SEEDS]
    return [(lift, lift.solve()) for lift in lifts]


@pytest.fixture(scope="module")
def stated(solved):
    statements = [lift.state() for lift, _ in solved]
    for statement in statements:
        solve_stated(statement.problem)
    return statements


def test_the_same_lifts_are_held_as_by_the_statement(solved, stated):
    verdicts = [isinstance(answer, Balanced) for _, answer in solved]
    assert verdicts == [statement.is_feasible for statement in stated]
    assert 0.25 < np.mean(verdicts) < 0.75


def test_the_least_effort_is_that_of_the_statement(solved, stated):
    for (_, answer), statement in zip(solved, stated, strict=True):
        if isinstance(answer, Balanced):
            assert answer.objective == pytest.approx(statement.problem.value, rel=1e-5, abs=1e-4)
            assert answer.objective == pytest.approx(answer.f_plus_gp + 0.1 * answer.suction_force, abs=1e-9)


def test_wrenches_balance_the_weight_to_rounding(solved):
    for lift, answer in solved:
        if isinstance(answer, Balanced):
            arms = (answer.points - lift.plate.com) @ lift.rotation.T
            forces, torques = answer.wrenches_world[:, :3], answer.wrenches_world[:, 3:]
            assert np.abs(forces.sum(axis=0) - [0, 0, lift.plate.mass * 9.81]).max() < 1e-9
            assert np.abs((torques + np.cross(arms, forces)).sum(axis=0)).max() < 1e-9


def test_wrenches_keep_inside_every_limit(solved):
    for lift, answer in solved:
        if isinstance(answer, Balanced):
            margins = [margin for k in range(len(answer.contacts)) for margin in contract_margins(lift, answer, k)]
            limits = lift.plate.limits
            grip, push = net_hand_forces(answer)
            margins += [limits.grip - grip, limits.push - push]
            if limits.squeeze is not None and lift.grip is not None:
                margins.append(limits.normal - grip)
                assert answer.wrenches_contact[:2, 2].sum() == pytest.approx(2.0 * limits.squeeze, abs=1e-9)
            # Torque limits of the pad are 1e-6 N inside at an arm of its radius.
            assert min(margins) > 1e-8
            assert answer.least_slack > 1e-7


def test_every_refusal_is_proven(solved):
    for _, answer in solved:
        if isinstance(answer, Unbalanced):
            assert answer.reason is UnbalanceReason.PROVEN
            assert answer.power < 0.0


def test_the_proof_is_a_twist_that_no_allowed_forces_can_drive(solved, stated):
    """Ask cvxpy for the most power along the proof's twist, without the closed forms."""
    refused = [(lift, a, s) for (lift, a), s in zip(solved, stated, strict=True) if isinstance(a, Unbalanced)]
    for lift, answer, statement in refused[::7]:
        best = lift.most_power(statement, answer.proof.twist)
        assert best < 0.0
        assert best < answer.power + 1e-5


def test_answers_do_not_depend_on_what_was_solved_before(random_lift):
    lift, other = random_lift(1, "paper", 2, True, True), random_lift(2, "paper", 2, True, True)
    balance = lift.balance
    balance.solve(other.rotation, other.environment_points, other.grip, other.push)
    again = balance.solve(lift.rotation, lift.environment_points, lift.grip, lift.push)
    first = lift.solve()
    assert isinstance(first, Balanced)
    assert np.array_equal(again.wrenches_contact, first.wrenches_contact)


def contract_margins(lift, answer, contact):
    """Read one contact's limits off its world wrench as a reader of the plan document would."""
    plate, friction = lift.plate, lift.plate.friction
    name, wrench_world = answer.contacts[contact], answer.wrenches_world[contact]
    R_contact_world = (lift.rotation @ answer.rotations[contact]).T
    force, torque = R_contact_world @ wrench_world[:3], R_contact_world @ wrench_world[3:]
    slip = np.hypot(*force[:2])
    if name == "cup":
        yield from cup_margins(plate, wrench_world, force, torque)
    elif name.startswith("grip"):
        yield friction.grip * force[2] - math.hypot(slip, torque[2] / friction.eps)
        yield plate.limits.normal - force[2] if plate.limits.squeeze is None else force[2]
    else:
        yield getattr(friction, name.split("_")[0]) * force[2] - slip
        if name == "push":
            yield plate.limits.normal - force[2]


def cup_margins(plate, wrench_world, force, torque):
    cup, pull = plate.cup, -force[2]
    if plate.lifter_model == "cable":
        assert np.abs(np.delete(wrench_world, 2)).max() < 1e-9
        yield from (wrench_world[2], cup.max_force - wrench_world[2])
        return
    grip = cup.mu * (pull if plate.lifter_model == "paper" else cup.max_force - pull)
    yield from (pull, cup.max_force - pull)
    yield from grip - math.sqrt(3) * np.abs(force[:2])
    yield cup.radius * grip - math.sqrt(3) * abs(torque[2])
    yield from math.pi * cup.radius * cup.kappa - math.sqrt(2) * np.abs(torque[:2])


def net_hand_forces(answer):
    for hand in ("grip", "push"):
        forces = [
            wrench[:3]
            for name, wrench in zip(answer.contacts, answer.wrenches_world, strict=True)
            if name.startswith(hand)
        ]
        yield float(np.linalg.norm(np.sum(forces, axis=0))) if forces else 0.0


@pytest.mark.parametrize("limit", [1e3, 1e6, 1e9])
def test_a_limit_that_is_never_come_near_changes_nothing(random_lift, monkeypatch, limit):
    lifts = [random_lift(seed, "paper", 2, True, True) for seed in range(12)]
    answers = [lift.solve() for lift in lifts]
    assert any(isinstance(answer, Balanced) for answer in answers)
    monkeypatch.setattr(Template, "_by_clarabel", None)
    for lift, answer in zip(lifts, answers, strict=True):
        if isinstance(answer, Balanced):
            limits = replace(lift.plate.limits, push=limit)
            freer = replace(lift, plate=replace(lift.plate, limits=limits)).solve()
            assert isinstance(freer, Balanced)
            assert freer.objective <= answer.objective + 1e-5


@pytest.mark.parametrize("model", get_args(LifterModel))
def test_no_forces_are_told_of_what_is_no_number_and_nothing_is_proven(random_lift, model):
    lift = random_lift(0, model, 2, True, True)
    turned = replace(lift, rotation=np.full((3, 3), np.nan))
    answer = turned.solve()
    assert isinstance(answer, Unbalanced)
    assert answer.reason is UnbalanceReason.WITHIN_TOLERANCE


def test_a_cable_alone_holds_a_plate_below_its_point_and_no_other(monkeypatch):
    monkeypatch.setattr(Template, "_by_clarabel", None)
    for offset in (0.0, 0.01, 0.1):
        cup = Cup.on_top((offset, 0.0, 0.02), 0.0175, 60.0)
        balance = Balance(4.0, np.zeros(3), cup, Friction(), HandLimits(), "cable")
        answer = balance.solve(np.eye(3), np.zeros((0, 3)))
        assert isinstance(answer, Balanced if offset == 0.0 else Unbalanced)
        if isinstance(answer, Unbalanced):
            assert answer.reason is UnbalanceReason.PROVEN


def test_what_is_asked_of_clarabel_is_answered_alike(solved, monkeypatch):
    quick = Template.solve
    monkeypatch.setattr(Template, "solve", lambda self, *given: quick(self, *given[:3], manner=Manner.CAREFUL))
    for lift, answer in solved:
        careful = lift.solve()
        assert isinstance(careful, Balanced) == isinstance(answer, Balanced)
        if isinstance(careful, Balanced) and isinstance(answer, Balanced):
            # It keeps farther inside the limits.
            assert careful.objective == pytest.approx(answer.objective, rel=1e-4, abs=1e-3)
