"""The cone program (5): our own method, Clarabel with the same matrices, and cvxpy."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence

import cvxpy as cp
import numpy as np

from planners.balance.balanced import Balanced
from tests.benchmarks.bench_balance import PLATE, BalanceNode, balance_nodes, clarabel_effort, new_balance
from tests.benchmarks.peers.contest import Contest, Entry, answers_of
from tests.benchmarks.tasks import Note
from tests.support.balance_statement import state_balance

CLOSE = 1e-3
"""Relative difference of efforts that counts as none."""
TEXT = (
    "Random poses, grips and pushes of a plate. Ours is compiled, and checks what it finds; *Clarabel* is given the "
    "same matrices, by a solver that is set up for each; *cvxpy* states the program as the paper prints it, in full "
    "wrenches, and solves it by Clarabel, too. Solved: balanced or not as cvxpy says, with the same least effort; of "
    "cvxpy: its answer is not called inaccurate. Size: the least effort."
)


def balance_contest(problems: int, note: Note) -> Contest:
    """Return the contest on random lifts."""
    note("peers: the cone program")
    nodes = balance_nodes(problems)
    kept = new_balance()
    with warnings.catch_warnings():
        # What is inaccurate is counted.
        warnings.simplefilter("ignore", UserWarning)
        stated, stated_seconds = _warm_answers(_stated_effort, nodes)
    ours, ours_seconds = _warm_answers(lambda node: _effort(kept.solve(*node)), nodes)
    theirs, their_seconds = _warm_answers(lambda node: clarabel_effort(kept, node), nodes)
    return Contest(
        f"the cone program ({problems})",
        _judged("ours", ours_seconds, ours, stated),
        [
            _judged("Clarabel, same matrices", their_seconds, theirs, stated),
            _judged("cvxpy", stated_seconds, stated, stated),
        ],
        "least effort",
        text=TEXT,
    )


def _stated_effort(node: BalanceNode) -> float | None:
    """Return the effort, infinite if there is no balance, or None where the solver is not sure."""
    problem = state_balance(PLATE, *node).problem
    effort = problem.solve(solver="CLARABEL")
    return float(effort) if problem.status in (cp.OPTIMAL, cp.INFEASIBLE) else None


def _effort(answer: object) -> float:
    return answer.objective if isinstance(answer, Balanced) else np.inf


def _warm_answers(
    run: Callable[[BalanceNode], float | None], nodes: Sequence[BalanceNode]
) -> tuple[list[float | None], list[float]]:
    run(nodes[0])
    return answers_of(run, nodes)


def _judged(
    name: str, seconds: Sequence[float], efforts: Sequence[float | None], stated: Sequence[float | None]
) -> Entry:
    """Where cvxpy is not sure, nobody else is judged wrong."""
    agree = [
        efforts is not stated if right is None else _same(effort, right)
        for effort, right in zip(efforts, stated, strict=True)
    ]
    sizes = [
        effort if ok and effort is not None and np.isfinite(effort) and effort > 0.0 else np.nan
        for ok, effort in zip(agree, efforts, strict=True)
    ]
    return Entry(name, seconds, agree, sizes, [effort is not None for effort in efforts])


def _same(effort: float | None, right: float) -> bool:
    if effort is None or np.isinf(effort) or np.isinf(right):
        return effort == right
    return abs(effort - right) <= CLOSE * max(1.0, abs(right))
