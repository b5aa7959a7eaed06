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
from enum import Enum
from functools import cached_property
from typing import NamedTuple, Self

import clarabel
import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import sparse

from planners.balance.contacts import Friction, HandLimits
from planners.balance.lifter import Lifter
from planners.geometry.pose import Array

TORQUE_LENGTH = 0.1
"""Torque balance is solved in N at this arm [m]: half a plate, so that force and torque rows are of one size."""
TIGHTENING = 1e-6
"""Every limit is solved this much inside [N], so that what rounding takes stays on the safe side ..."""
CAREFUL_TIGHTENING = 2e-5
"""... and so much where that was not enough: forces of a squeeze are large, and so is what rounding takes."""
K_HAND = 1.0
"""k_gp, weight of f+_gp in (5a); the paper prints none."""
K_SUCTION = 0.1
"""k_s, weight of f+_s in (5a); any 0...0.5 gives the same plans."""


class Structure(NamedTuple):
    """Which contacts there are; problems of one structure share a template."""

    environment: int
    grip: bool
    push: bool


class Fingers(NamedTuple):
    """How the eight forces of two fingers follow from the gripper's variables: `basis @ x + rest`."""

    basis: Array
    """(8, k): rows (fx, fy, fz, torque / eps) of finger 0, then of finger 1, each in its contact frame."""
    rest: Array
    """(8,) what they exert when all variables are zero [N]."""

    @classmethod
    def of(cls, squeeze: float | None) -> Fingers:
        """Return two free fingers, or two that are squeezed together with a force each [N].

        The normal forces of squeezed fingers add up to twice the squeeze: s + d and s - d, with one variable d.
        """
        if squeeze is None:
            return cls(np.eye(8), np.zeros(8))
        basis = np.delete(np.eye(8), 6, axis=1)
        basis[6, 2] = -1.0
        rest = np.zeros(8)
        rest[[2, 6]] = squeeze
        return cls(basis, rest)


@dataclass(frozen=True)
class Columns:
    """Where each contact's variables stand in x."""

    fingers: Fingers
    grip: slice | None
    """Both fingers together; see `fingers`."""
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
    def of(cls, structure: Structure, lifter: Lifter, squeeze: float | None) -> Columns:
        """Lay out the variables: fingers, push, environment, lifter, f+_gp."""
        fingers = Fingers.of(squeeze)
        gripping = [fingers.basis.shape[1]] * structure.grip
        sizes = [*gripping, *[3] * structure.push, *[3] * structure.environment, lifter.size]
        ends = np.cumsum(sizes).tolist()
        slices = [slice(end - size, end) for size, end in zip(sizes, ends, strict=True)]
        has_hand = structure.grip or structure.push
        return cls(
            fingers=fingers,
            grip=slices[0] if structure.grip else None,
            push=slices[structure.grip] if structure.push else None,
            environment=tuple(slices[structure.grip + structure.push : -1]),
            lifter=slices[-1],
            pull=slices[-1].start + lifter.pull,
            hand_effort=ends[-1] if has_hand else None,
            wrench_size=ends[-1],
            size=ends[-1] + has_hand,
        )

    @property
    def effort(self) -> int:
        """The place of f+_gp, where there is a hand."""
        assert self.hand_effort is not None
        return self.hand_effort

    @cached_property
    def names(self) -> tuple[str, ...]:
        """The contacts, in this order; see `Balanced.contacts`."""
        fingers = () if self.grip is None else ("grip_0", "grip_1")
        push = ("push",) if self.push is not None else ()
        return (*fingers, *push, *(f"environment_{index}" for index in range(len(self.environment))), "cup")

    def of_fingers(self, x: Array) -> Array:
        """Return (2, 4): (fx, fy, fz, torque / eps) of each finger [N]."""
        return (self.fingers.basis @ x[self.grip] + self.fingers.rest).reshape(2, 4)


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

    def at_least(self, index: int, bound: float) -> None:
        row = np.zeros(self.size)
        row[index] = 1.0
        self.linear.append((row, -bound))

    def no_more_than(self, row: Array, index: int) -> None:
        """Bound `row @ x`, with a row (size,), by the variable at an index."""
        bounded = -row
        bounded[index] += 1.0
        self.linear.append((bounded, 0.0))

    def of_variables(self, columns: slice) -> Array:
        """Return the rows (k, size) that pick variables out of x."""
        return np.eye(self.size)[columns]

    def friction(self, forces: Array, mu: float, rest: Array | None = None) -> None:
        """(5c)-(5e): mu times the third of `forces @ x + rest`, (k, size) and (k,), bounds the norm of the others."""
        order = [2, *(row for row in range(len(forces)) if row != 2)]
        scale = np.array([mu, *np.ones(len(forces) - 1)])
        offset = np.zeros(len(forces)) if rest is None else scale * rest[order]
        self.second_order.append((scale[:, None] * forces[order], offset))

    def norm_at_most(self, block: Array, bound: float, index: int | None = None) -> int:
        """Bound the norm of `block @ x`, with a block (k, size), by a number or by the variable at an index.

        Returns:
            The cone's place among the second-order cones.
        """
        offset = np.zeros(len(block) + 1)
        offset[0] = bound
        head = np.zeros(self.size)
        if index is not None:
            head[index] = 1.0
        self.second_order.append((np.vstack([head, block]), offset))
        return len(self.second_order) - 1


class Manner(Enum):
    """How a program is solved."""

    QUICK = "for the least effort"
    CAREFUL = "for the least effort, every step's solution refined, farther inside the limits; takes half as long again"
    CENTRAL = "for forces far from all limits, whatever the effort"


class Sparsity(NamedTuple):
    """Where a program's matrix, balance above the other rows, has entries, and where they are stored."""

    pattern: sparse.csc_matrix
    """(6 + m, size) of True."""
    stored: NDArray[np.intp]
    """(6 + m, size): the place of each entry among those stored, which run down the columns; -1 without."""

    @classmethod
    def of(cls, pattern: NDArray[np.bool_]) -> Self:
        """Return the sparsity of a matrix that has entries where a pattern (6 + m, size) is True."""
        stored = np.full(pattern.T.shape, -1)
        stored[pattern.T] = np.arange(int(pattern.sum()))
        return cls(sparse.csc_matrix(pattern), stored.T)


class CompiledSolvers:
    """Solvers by the shape of their programs: all numbers that limits change are written anew for every problem."""

    def __init__(self) -> None:
        self._sparsities: dict[tuple[int, bytes], Sparsity] = {}
        self._known: dict[tuple[Manner, int, bytes, tuple[int, ...]], clarabel.DefaultSolver] = {}

    def sparsity(self, pattern: NDArray[np.bool_]) -> Sparsity:
        """Return the sparsity of a pattern (6 + m, size): programs with other limits have the same one."""
        key = (len(pattern), pattern.tobytes())
        known = self._sparsities.get(key)
        if known is None:
            known = self._sparsities[key] = Sparsity.of(pattern)
        return known

    def of(
        self, manner: Manner, sparsity: Sparsity, cost: Array, b: Array, sizes: tuple[int, ...]
    ) -> clarabel.DefaultSolver:
        """Return the solver of a shape, compiled where it is new.

        Args:
            manner: how it solves.
            sparsity: of the rows, from `sparsity`.
            cost: (size,) of the variables.
            b: (m,) any right side of the rows.
            sizes: number of linear rows, then of the rows of each second-order cone.
        """
        key = (manner, id(sparsity), cost.tobytes(), sizes)
        known = self._known.get(key)
        if known is None:
            kinds = [clarabel.ZeroConeT(6), clarabel.NonnegativeConeT(sizes[0])]
            kinds += [clarabel.SecondOrderConeT(size) for size in sizes[1:]]
            # The stored values do not matter for the sparsity; ones keep the first equilibration away from zeros.
            ones, empty = sparsity.pattern.astype(float), sparse.csc_matrix((len(cost), len(cost)))
            weighed = np.zeros_like(cost) if manner is Manner.CENTRAL else cost
            settings = _solver_settings(refined=manner is Manner.CAREFUL)
            known = self._known[key] = clarabel.DefaultSolver(empty, weighed, ones, b, kinds, settings)
        return known


class ConeProgram(NamedTuple):
    """Program (5) of one pose and hold in numbers: `balance @ x = load`, and `rows @ x + offsets` in cones."""

    balance: Array
    """(6, k), (5b): takes the variables to the plate's wrench, torques over `TORQUE_LENGTH` [N]."""
    load: Array
    """(6,) what they have to balance, likewise [N]."""
    rows: Array
    """(m, k), (5c)-(5j): first linear rows, which are not to be negative, then second-order cones, head first."""
    offsets: Array
    """(m,) [N]."""
    sizes: tuple[int, ...]
    """Number of linear rows, then of the rows of each second-order cone; they add up to m."""
    pull: int
    """Which variable is the cup's net pull."""


class Template:
    """One compiled cone program; `solve` writes new data into it. Not for use by two threads at once."""

    def __init__(
        self,
        structure: Structure,
        lifter: Lifter,
        friction: Friction,
        limits: HandLimits,
        compiled: CompiledSolvers,
    ) -> None:
        """State the program of one structure; the contacts' places come with `solve`."""
        self._compiled = compiled
        self.columns = columns = Columns.of(structure, lifter, limits.squeeze)
        self.cost = np.zeros(columns.size)
        self.cost[columns.pull] = K_SUCTION
        self._effort_cone = -1
        cones, nets = self._collect(lifter, friction, limits)
        if columns.hand_effort is not None:
            self.cost[columns.hand_effort] = K_HAND
        self._linear = len(cones.linear)
        sizes = [len(offset) for _, offset in cones.second_order]
        self._starts = self._linear + np.concatenate([[0], np.cumsum(sizes)]).astype(int)
        self.rows = np.vstack([row for row, _ in cones.linear] + [block for block, _ in cones.second_order])
        self.offsets = np.concatenate([[bound for _, bound in cones.linear], *(o for _, o in cones.second_order)])
        self._net_rows = [slice(self._starts[net] + 1, self._starts[net] + 4) for net in nets]
        self._build(sizes)

    def _collect(self, lifter: Lifter, friction: Friction, limits: HandLimits) -> tuple[_Cones, list[int]]:
        """Gather (5c)-(5j); return them and the places of the cones of the gripper's net force, whose rows change.

        The rows that say that f+_gp is no less than any hand's effort come first; `_bounding` counts them.
        """
        columns = self.columns
        cones = _Cones(columns.size)
        fingers = np.zeros((2, 4, columns.size))
        if columns.grip is not None:
            fingers[:, :, columns.grip] = columns.fingers.basis.reshape(2, 4, -1)
        efforts = [] if columns.grip is None or limits.squeeze is not None else [finger[2] for finger in fingers]
        efforts += [] if columns.push is None else [cones.of_variables(columns.push)[2]]
        for row in efforts:
            cones.no_more_than(row, columns.effort)
        self._bounding = len(efforts)
        if columns.hand_effort is not None:
            cones.at_most(columns.hand_effort, limits.normal)
        block, offsets = lifter.limits()
        for part, offset in zip(block, offsets, strict=True):
            row = np.zeros(columns.size)
            row[columns.lifter] = part
            cones.linear.append((row, float(offset)))
        if columns.push is not None:
            if limits.least_push > 0.0:
                cones.at_least(columns.push.start + 2, limits.least_push)
            cones.friction(cones.of_variables(columns.push), friction.push)
            cones.norm_at_most(cones.of_variables(columns.push), limits.push)
        for point in columns.environment:
            cones.friction(cones.of_variables(point), friction.environment)
        return cones, [] if columns.grip is None else self._collect_grip(cones, fingers, friction, limits)

    def _collect_grip(self, cones: _Cones, fingers: Array, friction: Friction, limits: HandLimits) -> list[int]:
        """Gather the gripper's cones, `fingers` (2, 4, size) being its rows; return those of its net force."""
        for finger, rest in zip(fingers, self.columns.fingers.rest.reshape(2, 4), strict=True):
            cones.friction(finger, friction.grip, rest)
        nets, net = [], np.zeros((3, self.columns.size))
        if limits.squeeze is not None:
            self._effort_cone = len(cones.second_order)
            nets.append(cones.norm_at_most(net, 0.0, self.columns.effort))
        # f+_gp is at most `normal`, and bounds the net force of a squeezing gripper already.
        if limits.squeeze is None or limits.grip < limits.normal:
            nets.append(cones.norm_at_most(net, limits.grip))
        return nets

    def _build(self, sizes: list[int]) -> None:
        columns = self.columns
        matrix = np.vstack([np.zeros((6, columns.size)), -self.rows])
        pattern = matrix != 0.0
        pattern[:6, : columns.wrench_size] = True
        for rows in self._net_rows:
            pattern[6 + rows.start : 6 + rows.stop, columns.grip] = True
        self._sparsity = self._compiled.sparsity(pattern)
        # Where the entries that `solve` writes are stored.
        stored = self._sparsity.stored
        self._values = matrix.T[pattern.T]
        self._balance_at = stored[:6, : columns.wrench_size]
        self._net_at = [stored[6 + rows.start : 6 + rows.stop, columns.grip] for rows in self._net_rows]
        self._heads = np.zeros(6 + len(self.offsets))
        self._heads[6 : 6 + self._linear] = 1.0
        self._heads[6 + self._starts[:-1]] = 1.0
        self._b = np.concatenate([np.zeros(6), self.offsets]) - TIGHTENING * self._heads
        self._sizes = (self._linear, *sizes)
        self._solvers: dict[Manner, clarabel.DefaultSolver] = {}

    def solve(
        self, contact_map: Array, gravity: Array, squeezed: Array, manner: Manner = Manner.QUICK
    ) -> tuple[bool, Array, Array]:
        """Solve with new data.

        Args:
            contact_map: G of (5b), (6, wrench_size), to wrenches in plate axes about the centre of mass.
            gravity: Omega_g, (6,), in the same axes.
            squeezed: (6,), likewise, what the fingers exert when all variables are zero; nothing if they are opposite.
            manner: What is sought, and how.

        Returns:
            Whether the solver calls it infeasible; x; and the dual z of the rows, six of the balance, then the cones'.
        """
        self._values[self._balance_at[:3]] = contact_map[:3]
        self._values[self._balance_at[3:]] = contact_map[3:] / TORQUE_LENGTH
        for rows, at in zip(self._net_rows, self._net_at, strict=True):
            net = contact_map[:3, self.columns.grip]
            self.rows[rows, self.columns.grip] = net
            self._values[at] = -net
            self.offsets[rows] = self._b[6 + rows.start : 6 + rows.stop] = squeezed[:3]
        given = gravity + squeezed
        self._b[:3] = -given[:3]
        self._b[3:6] = -given[3:] / TORQUE_LENGTH
        solver = self._solver(manner)
        b = self._b - (CAREFUL_TIGHTENING - TIGHTENING) * self._heads if manner is Manner.CAREFUL else self._b
        # Lists cross over to the solver faster than arrays.
        solver.update(A=self._values.tolist(), b=b.tolist())
        solution = solver.solve()
        infeasible = solution.status == clarabel.SolverStatus.PrimalInfeasible
        return infeasible, np.array(solution.x), np.array(solution.z)

    def stated(self, contact_map: Array, gravity: Array, squeezed: Array) -> ConeProgram:
        """Return the program in numbers, with nothing tightened; the arguments are those of `solve`."""
        rows, offsets = self.rows.copy(), self.offsets.copy()
        for net in self._net_rows:
            rows[net, self.columns.grip] = contact_map[:3, self.columns.grip]
            offsets[net] = squeezed[:3]
        scale = np.repeat([1.0, 1.0 / TORQUE_LENGTH], 3)
        balance = np.zeros((6, self.columns.size))
        balance[:, : self.columns.wrench_size] = scale[:, None] * contact_map
        return ConeProgram(balance, -scale * (gravity + squeezed), rows, offsets, self._sizes, self.columns.pull)

    def _solver(self, manner: Manner) -> clarabel.DefaultSolver:
        solver = self._solvers.get(manner)
        if solver is None:
            solver = self._compiled.of(manner, self._sparsity, self.cost, self._b, self._sizes)
            self._solvers[manner] = solver
        return solver

    def least_slack(self, x: Array) -> float:
        """Return how far x, of the problem last solved, is inside the nearest untightened limit [N].

        The rows that make f+_gp the largest effort of a hand hold with equality at the largest, and do not count.
        """
        return _least_slack(self.rows, self.offsets, x, self._bounding, self._effort_cone, self._starts)

    def room(self, x: Array) -> Array:
        """Return (size,): how far each variable of x may move alone, as far as the limits are linear near x [N]."""
        return _room(self.rows, self.offsets, x, self._bounding, self._effort_cone, self._starts)

    def effort(self, x: Array) -> float:
        """Return the least f+_gp of the problem last solved: the largest effort of a hand [N]."""
        nets = self._net_rows[0] if self._effort_cone >= 0 else slice(0, 0)
        return _effort(self.rows, self.offsets, x, self._bounding, self.columns.effort, nets.start, nets.stop)

    def net_multiplier(self, z: Array) -> Array:
        """Return the part of the dual z that bounds on the gripper's net force hold, (3,); zeros without a gripper."""
        return sum((z[6 + rows.start : 6 + rows.stop] for rows in self._net_rows), start=np.zeros(3))


@njit(cache=True, nogil=True)
def _least_slack(
    rows: Array, offsets: Array, x: Array, skipped: int, skipped_cone: int, starts: NDArray[np.int64]
) -> float:
    """Return the least slack of the linear rows but the first, and of the cones but one, which begin at `starts`."""
    least = np.inf
    for row in range(skipped, starts[0]):
        least = min(least, rows[row] @ x + offsets[row])
    for cone in range(len(starts) - 1):
        if cone == skipped_cone:
            continue
        square = 0.0
        for row in range(starts[cone] + 1, starts[cone + 1]):
            square += (rows[row] @ x + offsets[row]) ** 2
        head = starts[cone]
        least = min(least, rows[head] @ x + offsets[head] - math.sqrt(square))
    return float(least)


@njit(cache=True, nogil=True)
def _effort(rows: Array, offsets: Array, x: Array, bounding: int, index: int, first: int, last: int) -> float:
    """Return the largest effort that the first rows bound by the variable at an index, and the norm of some rows."""
    largest, square = 0.0, 0.0
    for row in range(bounding):
        largest = max(largest, x[index] - rows[row] @ x)
    for row in range(first, last):
        square += (rows[row] @ x + offsets[row]) ** 2
    return max(largest, math.sqrt(square))


@njit(cache=True, nogil=True)
def _room(rows: Array, offsets: Array, x: Array, skipped: int, skipped_cone: int, starts: NDArray[np.int64]) -> Array:
    """Return the room of each variable; the limits that do not count are those of `_least_slack`."""
    room = np.full(x.shape[0], np.inf)
    for row in range(skipped, starts[0]):
        slack = max(0.0, rows[row] @ x + offsets[row])
        for column in range(x.shape[0]):
            if rows[row, column] != 0.0:
                room[column] = min(room[column], slack / abs(rows[row, column]))
    for cone in range(len(starts) - 1):
        if cone == skipped_cone:
            continue
        square, head = 0.0, starts[cone]
        for row in range(head + 1, starts[cone + 1]):
            square += (rows[row] @ x + offsets[row]) ** 2
        slack = max(0.0, rows[head] @ x + offsets[head] - math.sqrt(square))
        for column in range(x.shape[0]):
            length = abs(rows[head, column])
            for row in range(head + 1, starts[cone + 1]):
                length = max(length, abs(rows[row, column]))
            if length > 0.0:
                room[column] = min(room[column], slack / length)
    return room


def _solver_settings(*, refined: bool) -> clarabel.DefaultSettings:
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.presolve_enable = False
    settings.chordal_decomposition_enable = False
    settings.iterative_refinement_enable = refined
    settings.max_threads = 1
    return settings
