"""How far program (5) of paper B is from holding a plate: its limits relaxed, each by one more variable or two."""

# clarabel is a native module without stubs.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

from collections.abc import Sequence

import clarabel
import numpy as np
from scipy import sparse

from planners.balance.cone_program import TORQUE_LENGTH, ConeProgram
from planners.geometry.pose import Array

_NOTHING = 1e-6
"""Pulls below this have no place [N]."""


def least_force(program: ConeProgram) -> float | None:
    """Return how much more a cup has to pull at the least for a plate to be held [N]; None: no force of it would do."""
    given = np.zeros((len(program.offsets), 1))
    given[_limit_of_pull(program)] = 1.0
    found = _least(program, np.zeros((6, 1)), given, [clarabel.NonnegativeConeT(1)], np.ones((1, 1)))
    return None if found is None else float(found[-1])


def least_shift(program: ConeProgram) -> tuple[float, float] | None:
    """Return the nearest other place of the cup, from where it is, in plate axes [m]; None: no place would do.

    A cup that pulls with f along the plate's normal exerts, moved by d, the moment d x f more. The program that has
    this moment free, about the two axes in the plate's plane, is convex; the place follows from moment and pull. The
    moment of the cup's friction about the normal is left out: whoever moves the cup asks again.
    """
    # The norm of the moment, which is to be least, and the moment.
    about = np.zeros((6, 3))
    about[3, 1] = about[4, 2] = 1.0 / TORQUE_LENGTH
    none = np.zeros((len(program.offsets), 3))
    found = _least(program, about, none, [clarabel.SecondOrderConeT(3)], np.eye(3))
    if found is None:
        return None
    pull = float(found[program.pull])
    if pull < _NOTHING:
        return None
    # d x (0, 0, f) = (d_y f, -d_x f, 0)
    return -float(found[-1]) / pull, float(found[-2]) / pull


def _least(
    program: ConeProgram, balanced: Array, given: Array, cones: Sequence[object], in_cones: Array
) -> Array | None:
    """Return the variables (k + n,) with the least first one of n further ones; None where there are none.

    Args:
        program: with k variables and m limits.
        balanced: (6, n), what the further ones add to the balance.
        given: (m, n), what they add to the limits.
        cones: in which `in_cones` (l, n) takes them.
        in_cones: as said.
    """
    size, further = program.balance.shape[1], balanced.shape[1]
    cost = np.zeros(size + further)
    cost[size] = 1.0
    rows = np.block(
        [
            [program.balance, balanced],
            [-program.rows, -given],
            [np.zeros((len(in_cones), size)), -in_cones],
        ]
    )
    right = np.concatenate([program.load, program.offsets, np.zeros(len(in_cones))])
    linear, *orders = program.sizes
    kinds = [clarabel.ZeroConeT(6), clarabel.NonnegativeConeT(linear)]
    kinds += [*map(clarabel.SecondOrderConeT, orders), *cones]
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.max_threads = 1
    nothing = sparse.csc_matrix((len(cost), len(cost)))
    solution = clarabel.DefaultSolver(nothing, cost, sparse.csc_matrix(rows), right, kinds, settings).solve()
    return np.array(solution.x) if solution.status == clarabel.SolverStatus.Solved else None


def _limit_of_pull(program: ConeProgram) -> int:
    """Return the linear row that says how much the cup pulls at most."""
    linear = program.rows[: program.sizes[0]]
    alone = (np.count_nonzero(linear, axis=1) == 1) & (linear[:, program.pull] < 0.0)
    return int(np.flatnonzero(alone)[0])
