"""The compiled cone solver against Clarabel, on random programs, and its answers against what they claim."""

# clarabel is a native module without stubs.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import clarabel
import numpy as np
import pytest
from scipy import sparse

from planners.balance.interior_point import INFEASIBLE, SOLVED, STUCK, Cones, solve_cone_program
from planners.geometry.pose import Array
from tests.support.samples import sample

SEEDS = sample(range(60), range(5000))


class Program(NamedTuple):
    """A random program with the answers of both solvers."""

    balance: Array
    load: Array
    rows: Array
    offsets: Array
    cost: Array
    sizes: tuple[int, ...]

    def solve(self) -> tuple[int, Array, Array, Array]:
        """Ask ours."""
        return solve_cone_program(*self[:5], Cones.of(self.rows != 0.0, self.sizes))

    def ask(self) -> clarabel.DefaultSolution:
        """Ask Clarabel."""
        linear, *orders = self.sizes
        kinds = [clarabel.ZeroConeT(len(self.load)), clarabel.NonnegativeConeT(linear)]
        kinds += [clarabel.SecondOrderConeT(order) for order in orders]
        settings = clarabel.DefaultSettings()
        settings.verbose = False
        size = len(self.cost)
        rows = sparse.csc_matrix(np.vstack([self.balance, -self.rows]))
        right = np.concatenate([self.load, self.offsets])
        return clarabel.DefaultSolver(sparse.csc_matrix((size, size)), self.cost, rows, right, kinds, settings).solve()


def random_program(seed: int) -> Program:
    """Draw blocks of variables, cones around the origin or around their own axis, and a load that may be too large."""
    rng = np.random.default_rng(seed)
    blocks = rng.integers(1, 7, size=rng.integers(2, 6))
    edges = np.concatenate([[0], np.cumsum(blocks)])
    size = edges[-1] + 1
    linear, cones = [], []
    for first, end in pairwise(edges):
        # Every variable is bounded, some by the last one, which costs.
        ball = np.zeros((1 + end - first, size))
        ball[1:, first:end] = np.eye(end - first) * rng.uniform(0.5, 2.0)
        shared = rng.random() < 0.5
        ball[0, -1] = shared
        cones.append((ball, np.eye(1, len(ball))[0] * (0.0 if shared else rng.uniform(1.0, 40.0))))
        for _ in range(rng.integers(3)):
            row = np.zeros(size)
            row[first:end] = rng.normal(size=end - first)
            linear.append((row, rng.uniform(0.0, 5.0)))
        if end - first > 1 and rng.random() < 0.7:
            friction = np.zeros((end - first, size))
            friction[:, first:end] = np.diag([rng.uniform(0.2, 0.9), *np.ones(end - first - 1)])
            cones.append((friction, np.zeros(end - first)))
    linear += [(np.eye(size)[-1], 0.0), (-np.eye(size)[-1], rng.uniform(5.0, 60.0))]
    balance = np.concatenate([rng.normal(size=(min(6, size - 2), size - 1)), np.zeros((min(6, size - 2), 1))], axis=1)
    return Program(
        balance,
        rng.normal(size=len(balance)) * rng.choice([1.0, 8.0, 40.0]),
        np.vstack([row for row, _ in linear] + [block for block, _ in cones]),
        np.concatenate([[bound for _, bound in linear], *(offset for _, offset in cones)]),
        np.eye(size)[-1] + 0.1 * np.abs(np.eye(size)[0]),
        (len(linear), *(len(block) for block, _ in cones)),
    )


def least_slack(program: Program, slacks: Array) -> float:
    """Return how far rows are inside their cones."""
    linear, *orders = program.sizes
    parts = np.split(slacks, np.cumsum([linear, *orders])[:-1])
    return min([parts[0].min(), *(part[0] - np.linalg.norm(part[1:]) for part in parts[1:])])


@pytest.fixture(scope="module", name="programs")
def solved_programs() -> list[tuple[Program, tuple[int, Array, Array, Array]]]:
    return [(program, program.solve()) for program in map(random_program, SEEDS)]


def test_no_verdict_is_another_than_clarabels_and_few_are_open(programs):
    theirs = {clarabel.SolverStatus.Solved: SOLVED, clarabel.SolverStatus.PrimalInfeasible: INFEASIBLE}
    # What Clarabel itself leaves open, it is no authority for.
    verdicts = [(status, theirs.get(program.ask().status, status)) for program, (status, *_) in programs]
    assert {(SOLVED, SOLVED), (INFEASIBLE, INFEASIBLE)} <= set(verdicts)
    others = [verdict for verdict in verdicts if verdict[0] != verdict[1]]
    assert all(ours == STUCK for ours, _ in others)
    assert len(others) <= len(verdicts) / 500


def test_the_cost_is_that_of_clarabel(programs):
    for program, (status, x, _, _) in programs:
        answer = program.ask()
        if status == SOLVED and answer.status == clarabel.SolverStatus.Solved:
            assert program.cost @ x == pytest.approx(answer.obj_val, rel=5e-6, abs=5e-6)


def test_what_is_solved_balances_the_load_within_the_cones(programs):
    for program, (status, x, _, _) in programs:
        if status == SOLVED:
            unit = max(np.abs(program.load).max(), np.abs(program.offsets).max())
            assert np.abs(program.balance @ x - program.load).max() <= 2e-8 * unit
            assert least_slack(program, program.rows @ x + program.offsets) >= -2e-8 * unit


def test_no_cost_is_less_than_the_dual_says(programs):
    for program, (status, x, y, z) in programs:
        if status == SOLVED:
            assert least_slack(program, z) >= 0.0
            np.testing.assert_allclose(program.balance.T @ y - program.rows.T @ z, -program.cost, atol=1e-7)
            bound = -(program.load @ y + program.offsets @ z)
            assert program.cost @ x == pytest.approx(bound, rel=1e-6, abs=1e-6)


def test_a_program_without_solution_is_proven_to_have_none(programs):
    """By Farkas: were there an x, `z @ (rows @ x + offsets)` would be negative, with both in the cones."""
    for program, (status, _, y, z) in programs:
        if status == INFEASIBLE:
            assert least_slack(program, z) >= 0.0
            assert program.load @ y + program.offsets @ z == pytest.approx(-1.0)
            np.testing.assert_allclose(program.balance.T @ y, program.rows.T @ z, atol=1e-7)


def test_units_do_not_matter(programs):
    for program, (status, x, _, _) in programs[:40]:
        scaled = program._replace(load=1e3 * program.load, offsets=1e3 * program.offsets)
        again, larger, _, _ = scaled.solve()
        assert again == status
        if status == SOLVED:
            np.testing.assert_allclose(program.cost @ larger, 1e3 * (program.cost @ x), rtol=1e-9, atol=1e-6)


def test_what_is_no_program_ends_and_is_not_called_solved():
    program = random_program(0)
    for member in ("balance", "load", "rows", "offsets", "cost"):
        numbers = getattr(program, member).copy()
        numbers.flat[np.flatnonzero(numbers)[0] if numbers.any() else 0] = np.nan
        # Where the entries are is known from the program as it was.
        cones = Cones.of(program.rows != 0.0, program.sizes)
        assert solve_cone_program(*program._replace(**{member: numbers})[:5], cones)[0] == STUCK, member
