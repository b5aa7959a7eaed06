"""The balance program (5) as a cone program, one for each contact structure.

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
from typing import NamedTuple

import clarabel
import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import sparse

from planners.balance.contacts import Friction, HandLimits
from planners.balance.interior_point import INFEASIBLE, Cones, factor, solve_cone_program, solve_factored
from planners.balance.lifter import Lifter
from planners.geometry.pose import Array

TORQUE_LENGTH = 0.1
"""Torque balance is solved in N at this arm [m]: half a plate, so that force and torque rows are of one size."""
TIGHTENING = 1e-6
"""Every limit is solved this much inside [N], so that what rounding takes stays on the safe side ..."""
CAREFUL_TIGHTENING = 2e-5
"""... and so much where that was not enough: forces of a squeeze are large, and so is what rounding takes."""
_DAMPING = 1e-13
"""Of the normal equations that close the balance, relative to their trace."""
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
    CAREFUL = "for the least effort, by Clarabel, farther inside the limits; takes many times as long"
    CENTRAL = "for forces far from all limits, whatever the effort"


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


class ProgramAnswer(NamedTuple):
    """Forces that close the balance as well as they can, or what proves that there are none."""

    infeasible: bool
    """Whether the solver calls the program so."""
    x: Array
    """(size,) [N]; nothing where it is infeasible."""
    z: Array
    """(6 + m,) the dual of the rows: six of the balance, then the cones'."""
    residual: Array
    """(6,) what x leaves of (5b), torques over `TORQUE_LENGTH` [N]."""
    slack: float
    """How far x is inside the nearest untightened limit [N]."""
    hands: Array
    """(2, 6) the wrenches of gripper and stick, as the contact map gives them [N]."""


class _ProgramPlaces(NamedTuple):
    """Where a template's variables and rows stand, in numbers: -1 stands for what there is none of."""

    bounding: int
    """So many rows say that f+_gp is no less than any hand's effort. They come first, hold with equality at the largest
    effort, and count as no limit."""
    effort_cone: int
    """The second-order cone that says the same of the gripper's net force."""
    starts: NDArray[np.int64]
    """Where the second-order cones begin among the rows, and the last one's end."""
    effort: int
    """Variable f+_gp."""
    grip: tuple[int, int]
    """The gripper's variables: first, and behind the last."""
    push: tuple[int, int]


class _Program(NamedTuple):
    """A template in numbers."""

    rows: Array
    """(m, size), first linear rows, then second-order cones, head first."""
    offsets: Array
    """(m,) [N]."""
    heads: Array
    """(m,) 1 for linear rows and for heads of cones, and 0 for others: what is taken off when limits are tightened."""
    cones: Cones
    layout: _ProgramPlaces


class Template:
    """One cone program; `solve` writes new data into it. Not for use by two threads at once."""

    def __init__(self, structure: Structure, lifter: Lifter, friction: Friction, limits: HandLimits) -> None:
        """State the program of one structure; the contacts' places come with `solve`."""
        self.columns = columns = Columns.of(structure, lifter, limits.squeeze)
        self.cost = np.zeros(columns.size)
        self.cost[columns.pull] = K_SUCTION
        self._effort_cone = -1
        cones, nets = self._collect(lifter, friction, limits)
        if columns.hand_effort is not None:
            self.cost[columns.hand_effort] = K_HAND
        sizes = [len(offset) for _, offset in cones.second_order]
        self._sizes = (len(cones.linear), *sizes)
        starts = len(cones.linear) + np.cumsum([0, *sizes])
        self.rows = np.vstack([row for row, _ in cones.linear] + [block for block, _ in cones.second_order])
        self.offsets = np.concatenate([[bound for _, bound in cones.linear], *(o for _, o in cones.second_order)])
        self._net_rows = [slice(starts[net] + 1, starts[net] + 4) for net in nets]
        self._free = np.zeros(columns.size)
        pattern = self.rows != 0.0
        for net in self._net_rows:
            pattern[net, columns.grip] = True
        heads = np.zeros(len(self.offsets))
        heads[: self._sizes[0]] = heads[starts[:-1]] = 1.0
        grip, push = ((0, 0) if each is None else (each.start, each.stop) for each in (columns.grip, columns.push))
        effort = -1 if columns.hand_effort is None else columns.hand_effort
        layout = _ProgramPlaces(self._bounding, self._effort_cone, starts, effort, grip, push)
        self._program = _Program(self.rows, self.offsets, heads, Cones.of(pattern, self._sizes), layout)

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

    def solve(self, contact_map: Array, load: Array, squeezed: Array, manner: Manner = Manner.QUICK) -> ProgramAnswer:
        """Solve with new data.

        Args:
            contact_map: G of (5b), (6, wrench_size), to wrenches in plate axes about the centre of mass, torques over
                `TORQUE_LENGTH` [N]; so are the others.
            load: (6,), what it has to make of the variables.
            squeezed: (6,), what the fingers exert when all variables are zero; nothing if they are opposite.
            manner: What is sought, and how.
        """
        if manner is Manner.CAREFUL:
            infeasible, x, z = self._by_clarabel(self.stated(contact_map, load, squeezed))
            return ProgramAnswer(infeasible, x, z, *self.closed(x, contact_map, load, squeezed))
        self._set_nets(contact_map, squeezed)
        cost = self._free if manner is Manner.CENTRAL else self.cost
        return ProgramAnswer(*_solved(contact_map, load, squeezed, cost, self._program))

    def _set_nets(self, contact_map: Array, squeezed: Array) -> None:
        """Write the rows of the gripper's net force."""
        for net in self._net_rows:
            self.rows[net, self.columns.grip] = contact_map[:3, self.columns.grip]
            self.offsets[net] = squeezed[:3]

    def _by_clarabel(self, program: ConeProgram) -> tuple[bool, Array, Array]:
        """Solve farther inside the limits; return whether it is infeasible, x and z."""
        settings = clarabel.DefaultSettings()
        settings.verbose = settings.presolve_enable = settings.chordal_decomposition_enable = False
        settings.max_threads = 1
        linear, *orders = program.sizes
        solution = clarabel.DefaultSolver(
            sparse.csc_matrix((self.columns.size, self.columns.size)),
            self.cost,
            sparse.csc_matrix(np.vstack([program.balance, -program.rows])),
            np.concatenate([program.load, program.offsets - CAREFUL_TIGHTENING * self._program.heads]),
            [clarabel.ZeroConeT(6), clarabel.NonnegativeConeT(linear), *map(clarabel.SecondOrderConeT, orders)],
            settings,
        ).solve()
        infeasible = solution.status == clarabel.SolverStatus.PrimalInfeasible
        return infeasible, np.array(solution.x), np.array(solution.z)

    def closed(self, x: Array, contact_map: Array, load: Array, squeezed: Array) -> tuple[Array, float, Array]:
        """Close the balance of forces x, in place; return `residual`, `slack` and `hands` of the answer.

        The template must have solved a problem with the same contacts last; the load may be another one.
        """
        return _closed(x, contact_map, load, squeezed, self._program)

    def stated(self, contact_map: Array, load: Array, squeezed: Array) -> ConeProgram:
        """Return the program in numbers, with nothing tightened; the arguments are those of `solve`."""
        self._set_nets(contact_map, squeezed)
        balance = np.zeros((6, self.columns.size))
        balance[:, : self.columns.wrench_size] = contact_map
        return ConeProgram(balance, load, self.rows.copy(), self.offsets.copy(), self._sizes, self.columns.pull)

    def room(self, x: Array) -> Array:
        """Return (size,): how far each variable of x may move alone, as far as the limits are linear near x [N]."""
        return _room(self.rows, self.offsets, x, self._program.layout)

    def net_multiplier(self, z: Array) -> Array:
        """Return the part of the dual z that bounds on the gripper's net force hold, (3,); zeros without a gripper."""
        return sum((z[6 + rows.start : 6 + rows.stop] for rows in self._net_rows), start=np.zeros(3))


@njit(cache=True, nogil=True)
def _solved(
    contact_map: Array, load: Array, squeezed: Array, cost: Array, program: _Program
) -> tuple[bool, Array, Array, Array, float, Array]:
    """Solve a program, and close the balance of what comes out; what is returned is a `ProgramAnswer`."""
    balance = np.zeros((6, len(cost)))
    balance[:, : contact_map.shape[1]] = contact_map
    offsets = program.offsets - TIGHTENING * program.heads
    status, x, y, z = solve_cone_program(balance, load, program.rows, offsets, cost, program.cones)
    residual, slack, hands = _closed(x, contact_map, load, squeezed, program)
    return status == INFEASIBLE, x, np.concatenate((y, z)), residual, slack, hands


@njit(cache=True, nogil=True)
def _closed(
    x: Array, contact_map: Array, load: Array, squeezed: Array, program: _Program
) -> tuple[Array, float, Array]:
    """Move x by the least it takes to meet (5b) to rounding, in place; set f+_gp to the least that it may be.

    Returns:
        (6,) what is left of the load; the least slack; and the hands' wrenches (2, 6).
    """
    rows, offsets, layout = program.rows, program.offsets, program.layout
    if not np.all(np.isfinite(x)):
        x[:] = 0.0
    residual = move_to_balance(x, contact_map, load, np.ones(len(x)))
    if layout.effort >= 0:
        x[layout.effort] = _effort(rows, offsets, x, layout)
    hands = np.zeros((2, 6))
    for axis in range(6):
        hands[0, axis] = squeezed[axis]
        for column in range(layout.grip[0], layout.grip[1]):
            hands[0, axis] += contact_map[axis, column] * x[column]
        for column in range(layout.push[0], layout.push[1]):
            hands[1, axis] += contact_map[axis, column] * x[column]
    return residual, _least_slack(rows, offsets, x, layout), hands


@njit(cache=True, nogil=True)
def move_to_balance(x: Array, contact_map: Array, load: Array, room: Array) -> Array:
    """Move x to meet (5b), in place, by the least in measures of the room that each variable has.

    Args:
        x: (size,).
        contact_map: (6, k), of the first k variables.
        load: (6,).
        room: (size,).

    Returns:
        (6,) what is left.
    """
    count = contact_map.shape[1]
    residual, normal = load.copy(), np.zeros((6, 6))
    for i in range(6):
        for column in range(count):
            residual[i] -= contact_map[i, column] * x[column]
        for j in range(i + 1):
            for column in range(count):
                normal[i, j] += contact_map[i, column] * contact_map[j, column] * room[column] * room[column]
    # A grain of damping for contacts that cannot exert every wrench.
    damping = _DAMPING * np.trace(normal)
    for i in range(6):
        normal[i, i] += damping
    factor(normal)
    # Twice for the last digits.
    for _ in range(2):
        twist = residual.copy()
        solve_factored(normal, twist)
        for column in range(count):
            step = 0.0
            for i in range(6):
                step += contact_map[i, column] * twist[i]
            step *= room[column] * room[column]
            x[column] += step
            for i in range(6):
                residual[i] -= contact_map[i, column] * step
    return residual


@njit(cache=True, nogil=True)
def _slack(rows: Array, offsets: Array, x: Array, start: int, end: int) -> float:
    """Return how far the rows of a second-order cone are inside it [N]."""
    square = 0.0
    for row in range(start + 1, end):
        square += _row(rows, offsets, x, row) ** 2
    return _row(rows, offsets, x, start) - math.sqrt(square)


@njit(cache=True, nogil=True)
def _row(rows: Array, offsets: Array, x: Array, row: int) -> float:
    total = offsets[row]
    for column in range(len(x)):
        total += rows[row, column] * x[column]
    return total


@njit(cache=True, nogil=True)
def _least_slack(rows: Array, offsets: Array, x: Array, layout: _ProgramPlaces) -> float:
    """Return the least slack of all limits, which are all rows but those that bound f+_gp from below."""
    least, starts = np.inf, layout.starts
    for row in range(layout.bounding, starts[0]):
        least = min(least, _row(rows, offsets, x, row))
    for cone in range(len(starts) - 1):
        if cone != layout.effort_cone:
            least = min(least, _slack(rows, offsets, x, starts[cone], starts[cone + 1]))
    return least


@njit(cache=True, nogil=True)
def _effort(rows: Array, offsets: Array, x: Array, layout: _ProgramPlaces) -> float:
    """Return the least that f+_gp may be: the largest effort of a hand [N]."""
    largest, now = 0.0, x[layout.effort]
    for row in range(layout.bounding):
        largest = max(largest, now - _row(rows, offsets, x, row))
    if layout.effort_cone >= 0:
        start, end = layout.starts[layout.effort_cone], layout.starts[layout.effort_cone + 1]
        largest = max(largest, now - _slack(rows, offsets, x, start, end))
    return largest


@njit(cache=True, nogil=True)
def _room(rows: Array, offsets: Array, x: Array, layout: _ProgramPlaces) -> Array:
    """Return the room of each variable within the limits that `_least_slack` counts."""
    room, starts = np.full(x.shape[0], np.inf), layout.starts
    for row in range(layout.bounding, starts[0]):
        slack = max(0.0, _row(rows, offsets, x, row))
        for column in range(x.shape[0]):
            if rows[row, column] != 0.0:
                room[column] = min(room[column], slack / abs(rows[row, column]))
    for cone in range(len(starts) - 1):
        if cone == layout.effort_cone:
            continue
        slack = max(0.0, _slack(rows, offsets, x, starts[cone], starts[cone + 1]))
        for column in range(x.shape[0]):
            length = 0.0
            for row in range(starts[cone], starts[cone + 1]):
                length = max(length, abs(rows[row, column]))
            if length > 0.0:
                room[column] = min(room[column], slack / length)
    return room
