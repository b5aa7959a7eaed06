"""The balance program (5) as a cone program with a fixed sparsity, one for each contact structure.

Minimise `cost @ x` subject to `G x = -gravity` (5b) and `E x + e` in a product of cones (5c)-(5j). All variables
are forces: torques are divided by the length that belongs to their contact (eps of a soft finger, the radius of
the cup), so that one tolerance in newtons fits them all.
"""

# clarabel is a native module without stubs.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import clarabel
import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import sparse

from planners.balance.contacts import Friction, HandForceLimit
from planners.balance.lifter import Lifter
from planners.geometry.pose import Array

TORQUE_LENGTH = 0.1
"""Torque balance is solved in N at this arm [m]: half a plate, so that force and torque rows are of one size."""
TIGHTENING = 1e-6
"""Every limit is solved this much inside [N], so that what rounding takes stays on the safe side."""
K_HAND = 1.0
"""k_gp, weight of f+_gp in (5a); the paper prints none."""
K_SUCTION = 0.1
"""k_s, weight of f+_s in (5a); any 0...0.5 gives the same plans."""


class Structure(NamedTuple):
    """Which contacts there are; problems of one structure share a template."""

    environment: int
    grip: bool
    push: bool


@dataclass(frozen=True)
class Columns:
    """Where each contact's variables stand in x."""

    fingers: tuple[slice, ...]
    """(fx, fy, fz, torque / eps) of each finger, in its contact frame."""
    push: slice | None
    environment: tuple[slice, ...]
    lifter: slice
    pull: int
    hand_effort: int | None
    """f+_gp; there is none without a hand."""
    wrench_size: int
    """Variables that make wrenches; all but f+_gp."""
    size: int

    @classmethod
    def of(cls, structure: Structure, lifter: Lifter) -> Columns:
        """Lay out the variables: fingers, push, environment, lifter, f+_gp."""
        sizes = [4, 4] * structure.grip + [3] * structure.push + [3] * structure.environment + [lifter.size]
        ends = np.cumsum(sizes).tolist()
        slices = [slice(end - size, end) for size, end in zip(sizes, ends, strict=True)]
        fingers = tuple(slices[: 2 * structure.grip])
        push = slices[len(fingers)] if structure.push else None
        has_hand = structure.grip or structure.push
        return cls(
            fingers=fingers,
            push=push,
            environment=tuple(slices[len(fingers) + structure.push : -1]),
            lifter=slices[-1],
            pull=slices[-1].start + lifter.pull,
            hand_effort=ends[-1] if has_hand else None,
            wrench_size=ends[-1],
            size=ends[-1] + has_hand,
        )

    @cached_property
    def hand_normals(self) -> list[int]:
        """The normal forces of the hands' contacts."""
        hands = [*self.fingers, *([self.push] if self.push else [])]
        return [columns.start + 2 for columns in hands]

    @cached_property
    def names(self) -> tuple[str, ...]:
        """The contacts, in this order; see `ContactWrench.name`."""
        fingers = tuple(f"grip_{index}" for index in range(len(self.fingers)))
        push = ("push",) if self.push is not None else ()
        return (*fingers, *push, *(f"environment_{index}" for index in range(len(self.environment))), "cup")


class _Cones:
    """Rows of `E x + e` being collected, each block with its cone."""

    def __init__(self, size: int) -> None:
        self.size = size
        self.linear: list[tuple[Array, float]] = []
        self.second_order: list[tuple[Array, Array]] = []

    def at_most(self, index: int, bound: float) -> None:
        row = np.zeros(self.size)
        row[index] = -1.0
        self.linear.append((row, bound))

    def friction(self, columns: slice, mu: float) -> None:
        """(5c)-(5e): the variables other than the third are at most mu times the third, which is the normal."""
        variables = range(columns.start, columns.stop)
        normal = columns.start + 2
        block = np.zeros((len(variables), self.size))
        block[0, normal] = mu
        for row, index in enumerate((i for i in variables if i != normal), start=1):
            block[row, index] = 1.0
        self.second_order.append((block, np.zeros(len(variables))))

    def norm_at_most(self, block: Array, bound: float) -> int:
        """Bound the norm of `block @ x`; return the cone's place among the second-order cones."""
        offset = np.zeros(len(block) + 1)
        offset[0] = bound
        self.second_order.append((np.vstack([np.zeros(self.size), block]), offset))
        return len(self.second_order) - 1


class Template:
    """One compiled cone program; `solve` writes new data into it. Not for use by two threads at once."""

    def __init__(self, structure: Structure, lifter: Lifter, friction: Friction, limits: HandForceLimit) -> None:
        """Compile the program of one structure; the contacts' places come with `solve`."""
        self.columns = columns = Columns.of(structure, lifter)
        self.cost = np.zeros(columns.size)
        self.cost[columns.pull] = K_SUCTION
        cones, net = self._collect(lifter, friction, limits)
        if columns.hand_effort is not None:
            self.cost[columns.hand_effort] = K_HAND
        self._linear = len(cones.linear)
        sizes = [len(offset) for _, offset in cones.second_order]
        self._starts = self._linear + np.concatenate([[0], np.cumsum(sizes)]).astype(int)
        self.rows = np.vstack([row for row, _ in cones.linear] + [block for block, _ in cones.second_order])
        self.offsets = np.concatenate([[bound for _, bound in cones.linear], *(o for _, o in cones.second_order)])
        self._net_rows = None if net is None else slice(self._starts[net] + 1, self._starts[net] + 4)
        self._build(sizes)

    def _collect(self, lifter: Lifter, friction: Friction, limits: HandForceLimit) -> tuple[_Cones, int | None]:
        """Gather (5c)-(5j); return them and the place of the gripper's net limit, whose rows change with the grip."""
        columns = self.columns
        cones = _Cones(columns.size)
        for normal in columns.hand_normals:
            row = np.zeros(columns.size)
            row[normal], row[columns.hand_effort] = -1.0, 1.0
            cones.linear.append((row, 0.0))
        if columns.hand_effort is not None:
            cones.at_most(columns.hand_effort, limits.normal)
        block, offsets = lifter.limits()
        for part, offset in zip(block, offsets, strict=True):
            row = np.zeros(columns.size)
            row[columns.lifter] = part
            cones.linear.append((row, float(offset)))
        for finger in columns.fingers:
            cones.friction(finger, friction.grip)
        if columns.push is not None:
            cones.friction(columns.push, friction.push)
            cones.norm_at_most(np.eye(columns.size)[columns.push], limits.net)
        for point in columns.environment:
            cones.friction(point, friction.environment)
        net = cones.norm_at_most(np.zeros((3, columns.size)), limits.net) if columns.fingers else None
        return cones, net

    def _build(self, sizes: list[int]) -> None:
        columns = self.columns
        matrix = np.vstack([np.zeros((6, columns.size)), -self.rows])
        pattern = matrix != 0.0
        pattern[:6, : columns.wrench_size] = True
        if self._net_rows is not None:
            for finger in columns.fingers:
                pattern[6 + self._net_rows.start : 6 + self._net_rows.stop, finger.start : finger.start + 3] = True
        # Where the entries that `solve` writes stand among the stored ones, which run down the columns.
        stored = np.full(pattern.T.shape, -1)
        stored[pattern.T] = np.arange(int(pattern.sum()))
        self._values = matrix.T[pattern.T]
        self._balance_at = stored[: columns.wrench_size, :6].T.copy()
        self._net_at = np.empty((3, 0), dtype=int)
        self._force_columns = np.array([finger.start + axis for finger in columns.fingers for axis in range(3)], int)
        if self._net_rows is not None:
            below = slice(6 + self._net_rows.start, 6 + self._net_rows.stop)
            self._net_at = stored[self._force_columns, below].T.copy()
        self._sparsity = sparse.csc_matrix(pattern)
        tightened = self.offsets.copy()
        tightened[: self._linear] -= TIGHTENING
        tightened[self._starts[:-1]] -= TIGHTENING
        self._b = np.concatenate([np.zeros(6), tightened])
        self._kinds = [clarabel.ZeroConeT(6), clarabel.NonnegativeConeT(self._linear)]
        self._kinds += [clarabel.SecondOrderConeT(size) for size in sizes]

    def solve(self, contact_map: Array, gravity: Array, *, careful: bool = False) -> tuple[bool, Array, Array]:
        """Solve with new data.

        Args:
            contact_map: G of (5b), (6, wrench_size), to wrenches in plate axes about the centre of mass.
            gravity: Omega_g, (6,), in the same axes.
            careful: Refine every step's solution; takes half as long again, and is seldom any better.

        Returns:
            Whether the solver calls it infeasible; x; and the dual z of the rows, six of the balance, then the cones'.
        """
        self._values[self._balance_at[:3]] = contact_map[:3]
        self._values[self._balance_at[3:]] = contact_map[3:] / TORQUE_LENGTH
        if self._net_rows is not None:
            net = contact_map[:3, self._force_columns]
            self.rows[self._net_rows, self._force_columns] = net
            self._values[self._net_at] = -net
        self._b[:3] = -gravity[:3]
        self._b[3:6] = -gravity[3:] / TORQUE_LENGTH
        solver = self._careful_solver if careful else self._quick_solver
        # Lists cross over to the solver faster than arrays.
        solver.update(A=self._values.tolist(), b=self._b.tolist())
        solution = solver.solve()
        infeasible = solution.status == clarabel.SolverStatus.PrimalInfeasible
        return infeasible, np.array(solution.x), np.array(solution.z)

    @cached_property
    def _quick_solver(self) -> clarabel.DefaultSolver:
        return self._compiled(refined=False)

    @cached_property
    def _careful_solver(self) -> clarabel.DefaultSolver:
        return self._compiled(refined=True)

    def _compiled(self, *, refined: bool) -> clarabel.DefaultSolver:
        # The stored values do not matter for the sparsity; ones keep the first equilibration away from zeros.
        ones = self._sparsity.astype(float)
        empty = sparse.csc_matrix((self.columns.size, self.columns.size))
        return clarabel.DefaultSolver(empty, self.cost, ones, self._b, self._kinds, _solver_settings(refined=refined))

    def least_slack(self, x: Array) -> float:
        """Return how far x, of the problem last solved, is inside the nearest untightened limit [N].

        The rows that make f+_gp the largest normal force hold with equality at the largest, and do not count.
        """
        return _least_slack(self.rows, self.offsets, x, len(self.columns.hand_normals), self._starts)

    def net_multiplier(self, z: Array) -> Array:
        """Return the part of the dual z that the gripper's net limit holds, (3,); zeros without a gripper."""
        if self._net_rows is None:
            return np.zeros(3)
        return z[6 + self._net_rows.start : 6 + self._net_rows.stop]


@njit(cache=True, nogil=True)
def _least_slack(rows: Array, offsets: Array, x: Array, skipped: int, starts: NDArray[np.int64]) -> float:
    """Return the least slack of the linear rows, the first ones skipped, and of the cones that start at `starts`."""
    least = np.inf
    for row in range(skipped, starts[0]):
        least = min(least, rows[row] @ x + offsets[row])
    for cone in range(len(starts) - 1):
        square = 0.0
        for row in range(starts[cone] + 1, starts[cone + 1]):
            square += (rows[row] @ x + offsets[row]) ** 2
        head = starts[cone]
        least = min(least, rows[head] @ x + offsets[head] - math.sqrt(square))
    return float(least)


def _solver_settings(*, refined: bool) -> clarabel.DefaultSettings:
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.presolve_enable = False
    settings.chordal_decomposition_enable = False
    settings.iterative_refinement_enable = refined
    settings.max_threads = 1
    return settings
