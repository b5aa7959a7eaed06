"""How far program (5) of paper B is from holding a plate: its limits relaxed, stated in cvxpy."""

from __future__ import annotations

from dataclasses import dataclass

import cvxpy as cp
import numpy as np

from planners.balance.cone_program import TORQUE_LENGTH, ConeProgram
from planners.geometry.pose import Array

_NOTHING = 1e-6
"""Pulls below this have no place [N]."""


@dataclass(frozen=True)
class Relaxed:
    """The least by which one limit has to give way for a plate to be held in one pose by one hold."""

    cup_force: float | None
    """More force of the cup [N]; None: no force of it would do."""
    cup_shift: tuple[float, float] | None
    """Another place of the cup, from where it is, in plate axes [m]; None: no place would do."""


def relaxed(program: ConeProgram) -> Relaxed:
    """Relax the cup's largest force, then its place, each alone.

    A cup that pulls with f along the plate's normal exerts, moved by d, the moment d x f more. The program that has
    this moment free, about the two axes in the plate's plane, is convex; the place follows from moment and pull. The
    moment of the cup's friction about the normal is left out: whoever moves the cup asks again.
    """
    return Relaxed(_least_force(program), _least_shift(program))


def _least_force(program: ConeProgram) -> float | None:
    more = cp.Variable(nonneg=True)
    x = cp.Variable(program.balance.shape[1])
    given = np.zeros(len(program.offsets))
    given[_limit_of_pull(program)] = 1.0
    problem = cp.Problem(cp.Minimize(more), [program.balance @ x == program.load, *_within(program, x, more * given)])
    problem.solve(solver=cp.CLARABEL)
    return float(more.value) if problem.status == cp.OPTIMAL and more.value is not None else None


def _least_shift(program: ConeProgram) -> tuple[float, float] | None:
    moment, x = cp.Variable(2), cp.Variable(program.balance.shape[1])
    about = np.zeros((6, 2))
    about[3, 0] = about[4, 1] = 1.0 / TORQUE_LENGTH
    held = program.balance @ x + about @ moment == program.load
    none = np.zeros(len(program.offsets))
    problem = cp.Problem(cp.Minimize(cp.norm(moment)), [held, *_within(program, x, none)])
    problem.solve(solver=cp.CLARABEL)
    if problem.status != cp.OPTIMAL or x.value is None or moment.value is None:
        return None
    pull = float(x.value[program.pull])
    if pull < _NOTHING:
        return None
    # d x (0, 0, f) = (d_y f, -d_x f, 0)
    return -float(moment.value[1]) / pull, float(moment.value[0]) / pull


def _limit_of_pull(program: ConeProgram) -> int:
    """Return the linear row that says how much the cup pulls at most."""
    linear = program.rows[: program.sizes[0]]
    alone = (np.count_nonzero(linear, axis=1) == 1) & (linear[:, program.pull] < 0.0)
    return int(np.flatnonzero(alone)[0])


def _within(program: ConeProgram, x: cp.Variable, more: cp.Expression | Array) -> list[cp.Constraint]:
    """Return (5c)-(5j) with so much more (m,) of every limit."""
    value = program.rows @ x + program.offsets + more
    linear, *cones = np.split(np.arange(len(program.offsets)), np.cumsum(program.sizes)[:-1])
    limits: list[cp.Constraint] = [value[linear] >= 0.0]
    return limits + [cp.SOC(value[cone[0]], value[cone[1:]]) for cone in cones]
