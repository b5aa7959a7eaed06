"""One proof of imbalance, tested everywhere: never wrong, and always right where it came from."""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from typing import get_args

import cvxpy as cp
import numpy as np
import pytest

from planners.balance.balanced import Unbalanced
from planners.balance.contacts import HandLimits
from planners.balance.proofs import TwistTable
from planners.contract.task_spec import LifterModel
from tests.support.balance_statement import state_balance

MODELS = get_args(LifterModel)
COUNTS = (0, 1, 2, 4)
TOPPLING = (0, 1, 2)
"""Numbers of environment points on which a plate does not stand by itself."""
TOO_HEAVY = 500.0
"""To be kept from toppling by any of the hands here [kg]."""


class Nodes:
    """All poses of one plate with all holds, solved one by one, and their table."""

    def __init__(self, model, random_lift, random_hands):
        rng = np.random.default_rng(3)
        lifts = [random_lift(seed, model, count, False, False) for seed, count in enumerate(COUNTS * 5)]
        self.plate, half = lifts[1].plate, lifts[1].half
        corners = half * np.array([[-1, -1, -1], [-1, 1, -1], [1, 1, -1], [1, -1, -1]])
        self.rotations = np.array([lift.rotation for lift in lifts])
        self.points = [corners[: len(lift.environment_points)] for lift in lifts]
        hands = [random_hands(rng, half) for _ in range(6)]
        self.grips, self.pushes = [None, *(g for g, _ in hands[:4])], [None, *(p for _, p in hands)]
        self.balance = lifts[1].balance
        self.table = TwistTable(self.balance, self.rotations, self.points, self.grips[1:], self.pushes[1:])
        self.indices = list(product(range(len(lifts)), range(len(self.grips)), range(len(self.pushes))))
        self.answers = {index: self.balance.solve(*self.at(index)) for index in self.indices}
        shape = (len(lifts), len(self.grips), len(self.pushes))
        self.refused = np.array([isinstance(self.answers[i], Unbalanced) for i in self.indices]).reshape(shape)

    def at(self, index):
        pose, grip, push = index
        return self.rotations[pose], self.points[pose], self.grips[grip], self.pushes[push]


@pytest.fixture(scope="module", params=MODELS)
def nodes(request, random_lift, random_hands):
    return Nodes(request.param, random_lift, random_hands)


def test_no_proof_declares_a_node_that_can_be_held(nodes):
    assert 0.1 < nodes.refused.mean() < 0.9
    for answer in nodes.answers.values():
        if isinstance(answer, Unbalanced):
            assert not np.any(nodes.table.infeasible(answer.proof) & ~nodes.refused)


def test_a_proof_declares_the_node_it_came_from(nodes):
    for index, answer in nodes.answers.items():
        if isinstance(answer, Unbalanced):
            assert nodes.table.infeasible(answer.proof)[index]


def test_few_proofs_refuse_all_that_can_be_refused(nodes):
    known = np.zeros_like(nodes.refused)
    solved = 0
    for index in nodes.indices:
        if nodes.refused[index] and not known[index]:
            proof = nodes.answers[index].proof
            known |= nodes.table.infeasible(proof)
            solved += 1
    assert np.array_equal(known, nodes.refused)
    assert solved < 0.3 * nodes.refused.sum()


def test_random_twists_declare_no_node_that_can_be_held(nodes):
    rng = np.random.default_rng(0)
    for twist in rng.standard_normal((300, 6)) * [1, 1, 1, 5, 5, 5]:
        assert not np.any(nodes.table.infeasible(twist) & ~nodes.refused)


def test_what_a_proof_declares_is_infeasible_in_the_statement(nodes):
    rng = np.random.default_rng(1)
    refused = [index for index in nodes.indices if nodes.refused[index]]
    source = refused[len(refused) // 2]
    declared = np.argwhere(nodes.table.infeasible(nodes.answers[source].proof))
    for index in rng.permutation(declared)[:12]:
        statement = state_balance(nodes.plate, *nodes.at(tuple(index)))
        statement.problem.solve(solver="CLARABEL")
        assert not statement.is_feasible


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize(
    ("squeeze", "normal", "net"), [(None, 17.0, 12.0), (None, 17.0, 1e3), (30.0, 12.0, 1e3), (30.0, 1e3, 1e3)]
)
def test_the_power_of_a_proof_is_the_most_of_all_allowed_forces(random_lift, model, squeeze, normal, net):
    """Without the gripper's net limit the closed form is exact, with it never too small."""
    for seed, count in enumerate(TOPPLING):
        lift = random_lift(seed, model, count, True, True)
        limits = HandLimits(normal, net, net, squeeze)
        heavy = replace(lift, plate=replace(lift.plate, limits=limits, mass=TOO_HEAVY))
        answer = heavy.solve()
        assert isinstance(answer, Unbalanced)
        best = heavy.most_power(heavy.state(), answer.proof.twist)
        assert answer.power >= best - 1e-5
        if net == 1e3 and (squeeze is None or normal == 1e3):
            assert answer.power == pytest.approx(best, rel=1e-6, abs=1e-5)


@pytest.mark.parametrize("model", MODELS)
def test_the_bound_on_the_environment_cuts_no_balance(random_lift, model):
    """Press the plate on the table as hard as the balance allows: still below the bound."""
    for seed, count in enumerate((1, 2, 4) * 3):
        lift = random_lift(seed, model, count, True, True)
        statement = lift.state()
        normals = [F[2] for name, F in statement.wrenches.items() if name.startswith("environment")]
        hardest = cp.Problem(cp.Maximize(sum(normals)), statement.problem.constraints).solve(solver="CLARABEL")
        assert hardest <= lift.balance.environment_bound + 1e-6
