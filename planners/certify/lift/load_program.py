"""How much heavier a plate could be and still be held: paper B's program (5), assembled from a document's contacts.

For one contact set all that its contacts could exert within their limits is a convex set that contains zero, so that a
load can be borne if it can be borne multiplied by more than one. The largest such factor is what is left: it is found
for every load asked for. `stated_factors` writes the same down as the paper prints it, for another solver to read.
"""

# clarabel is a native module without stubs.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import clarabel
import numpy as np
from scipy import sparse

from planners.certify.common.infeasibility import solve_with_care
from planners.geometry.pose import Array, skew
from planners.plan.contacts import BearingContact, SuctionContact
from planners.plan.scenery import ARMS

NOWHERE: Mapping[int, Array] = MappingProxyType({})
LARGEST_FACTOR = 2.0
"""No larger factor is looked for: a plate on a table bears any [1]."""
_LEVER = 0.1
"""Moments are compared with forces at this lever [m]."""


@dataclass(frozen=True, eq=False)
class ContactBounds:
    """What contacts may exert besides what they state themselves."""

    hands: Mapping[str, float]
    """By arm, largest net force of its hand [N]."""
    model: str
    """Of the lifter: "paper", "cable" or "dexnet"."""


@dataclass(frozen=True, eq=False)
class _Unknowns:
    """The unknowns of one contact."""

    contact: BearingContact
    axes: Array
    """(3, 3) columns: the contact frame in world axes, z along the normal into the body."""
    columns: slice
    basis: Array
    """(6, k): the wrench in the contact frame that the unknowns make."""


class LoadProgram:
    """One contact set, compiled; asked for one load after the other."""

    def __init__(
        self,
        contacts: Sequence[BearingContact],
        reference: Array,
        bounds: ContactBounds,
        beyond: Mapping[int, Array] = NOWHERE,
    ) -> None:
        """Assemble the program.

        Args:
            contacts: of one body at one sample.
            reference: (3,) point that moments are about, world [m].
            bounds: of hands and lifter.
            beyond: by number of a contact, another normal (3,) with which its force has to be possible, world axes.
        """
        self._beyond = beyond
        self._parts = _parts(contacts, bounds.model)
        self._size = sum(part.basis.shape[1] for part in self._parts)
        self._bounds = bounds
        self._rows: list[Array] = []
        self._offsets: list[float] = []
        self._cones: list[object] = []
        balance = np.hstack([_about(part, reference) for part in self._parts])
        balance[3:] /= _LEVER
        self._equal(balance, np.zeros(6))
        self._squeezes()
        self._limits()
        self._friction()
        self._nets()
        matrix = np.vstack(self._rows)
        # The factor is the last unknown; where it acts is filled in for every load.
        matrix = np.hstack([matrix, np.zeros((len(matrix), 1))])
        matrix[:6, -1] = 1.0
        cap = np.zeros((1, self._size + 1))
        cap[0, -1] = 1.0
        self._matrix = sparse.csc_matrix(np.vstack([matrix, cap]))
        cones = [*self._cones, clarabel.NonnegativeConeT(1)]
        offsets = np.array([*self._offsets, LARGEST_FACTOR])
        cost = np.zeros(self._size + 1)
        cost[-1] = -1.0
        settings = clarabel.DefaultSettings()
        settings.verbose = False
        settings.presolve_enable = False
        settings.max_threads = 1
        none = sparse.csc_matrix((self._size + 1, self._size + 1))
        self._solver = clarabel.DefaultSolver(none, cost, self._matrix, offsets, cones, settings)

    def factor(self, load: Array) -> float:
        """Return the largest factor at which the contacts bear a wrench, up to `LARGEST_FACTOR`; NaN if none is found.

        Args:
            load: (6,) that acts on the body, world axes, moment about the reference point.
        """
        data = self._matrix.data.copy()
        start = self._matrix.indptr[-2]
        data[start : start + 6] = np.concatenate([load[:3], load[3:] / _LEVER])
        self._solver.update(A=data.tolist())
        solution = self._solver.solve()
        solved = solution.status in (clarabel.SolverStatus.Solved, clarabel.SolverStatus.AlmostSolved)
        return float(solution.x[-1]) if solved else math.nan

    # Rows of `A x + s = b`, s in a cone.

    def _equal(self, rows: Array, values: Array) -> None:
        self._rows.append(rows)
        self._offsets += values.tolist()
        self._cones.append(clarabel.ZeroConeT(len(rows)))

    def _at_least_zero(self, row: Array, offset: float) -> None:
        """`row @ x + offset >= 0`."""
        self._rows.append(-row[None])
        self._offsets.append(offset)
        self._cones.append(clarabel.NonnegativeConeT(1))

    def _norm(self, head: Array, head_offset: float, rows: Array) -> None:
        """`|rows @ x| <= head @ x + head_offset`."""
        self._rows.append(-np.vstack([head, rows]))
        self._offsets += [head_offset, *([0.0] * len(rows))]
        self._cones.append(clarabel.SecondOrderConeT(1 + len(rows)))

    def _row(self, part: _Unknowns, values: Array) -> Array:
        row = np.zeros(self._size)
        row[part.columns] = values
        return row

    def _squeezes(self) -> None:
        """Fingers that squeeze press twice the squeeze together."""
        for arm in ARMS:
            fingers = [p for p in self._parts if p.contact.by == arm and p.contact.kind == "soft_finger"]
            squeeze = _squeeze(fingers[0].contact) if fingers else None
            if squeeze is not None:
                total = sum(self._row(part, part.basis[2]) for part in fingers)
                self._equal(np.asarray(total)[None], np.array([2.0 * squeeze]))

    def _limits(self) -> None:
        """Normal forces and pulls within their bounds."""
        for part in self._parts:
            values = part.contact
            if values.kind == "suction":
                pull = self._row(part, _pull(part))
                self._at_least_zero(pull, 0.0)
                self._at_least_zero(-pull, values.limit)
                if self._bounds.model != "cable":
                    self._pad(part, values, pull)
            elif values.limit is not None and _squeeze(values) is None:
                self._at_least_zero(-self._row(part, part.basis[2]), values.limit)

    def _pad(self, part: _Unknowns, values: SuctionContact, pull: Array) -> None:
        """(5f), (5g) of the paper, or Dex-Net's with the vacuum less the pull in the place of the pull."""
        sign, rest = (1.0, 0.0) if self._bounds.model == "paper" else (-1.0, values.mu * values.limit)
        holding = sign * values.mu * pull
        for index, scale in ((0, 1.0), (1, 1.0), (5, 1.0 / values.radius)):
            across = math.sqrt(3.0) * scale * self._row(part, part.basis[index])
            self._at_least_zero(holding - across, rest)
            self._at_least_zero(holding + across, rest)
        for index in (3, 4):
            bend = math.sqrt(2.0) / values.radius * self._row(part, part.basis[index])
            self._at_least_zero(-bend, math.pi * values.kappa)
            self._at_least_zero(bend, math.pi * values.kappa)

    def _friction(self) -> None:
        """(5c)-(5e)."""
        for part in self._parts:
            values = part.contact
            if values.kind == "suction":
                continue
            rows = [self._row(part, part.basis[0]), self._row(part, part.basis[1])]
            if values.kind == "soft_finger":
                rows.append(self._row(part, part.basis[5] / values.eps))
            self._norm(values.mu * self._row(part, part.basis[2]), 0.0, np.array(rows))
        for number, normal in self._beyond.items():
            part = self._parts[number]
            force = np.array([self._row(part, row) for row in part.axes @ part.basis[:3]])
            self._norm(part.contact.mu * normal @ force, 0.0, _across(normal) @ force)

    def _nets(self) -> None:
        """What a hand bears in all."""
        for arm in ARMS:
            parts = [part for part in self._parts if part.contact.by == arm]
            if parts:
                net = np.zeros((3, self._size))
                for part in parts:
                    net[:, part.columns] += part.axes @ part.basis[:3]
                self._norm(np.zeros(self._size), self._bounds.hands[arm], net)


def stated_factors(
    contacts: Sequence[BearingContact],
    reference: Array,
    bounds: ContactBounds,
    loads: Sequence[Array],
    beyond: Mapping[int, Array] = NOWHERE,
) -> list[float]:
    """Return the factors of loads as `LoadProgram.factor` does, from the program as paper B prints it, in cvxpy.

    Each contact has a whole wrench F in its own frame, of which (1) leaves some entries zero; (2) is its grasp map.
    """
    # Takes a second to import, and is needed once a certificate.
    import cvxpy as cp

    F = [cp.Variable(6) for _ in contacts]
    parts = _parts(contacts, bounds.model)
    factor, load = cp.Variable(), cp.Parameter(6)
    total: cp.Expression = factor * load
    limits: list[cp.Constraint] = [factor <= LARGEST_FACTOR]
    for wrench, part in zip(F, parts, strict=True):
        total = total + _grasp_map(part, reference) @ wrench
        limits += _stated_limits(wrench, part, bounds.model)
    for number, normal in beyond.items():
        force = parts[number].axes @ F[number][:3]
        limits.append(cp.norm(_across(normal) @ force) <= parts[number].contact.mu * (normal @ force))
    for arm in ARMS:
        mine = [(f, p) for f, p in zip(F, parts, strict=True) if p.contact.by == arm]
        if not mine:
            continue
        limits.append(cp.norm(sum(part.axes @ wrench[:3] for wrench, part in mine)) <= bounds.hands[arm])
        squeeze = _squeeze(mine[0][1].contact)
        if squeeze is not None:
            limits.append(cp.Zero(cp.sum(cp.hstack([wrench[2] for wrench, _ in mine])) - 2.0 * squeeze))
    problem = cp.Problem(cp.Maximize(factor), [total == 0, *limits])
    factors = []
    for asked in loads:
        load.value = asked
        solve_with_care(problem)
        factors.append(math.nan if factor.value is None else float(factor.value))
    return factors


def _stated_limits(F, part: _Unknowns, model: str) -> list:
    import cvxpy as cp

    values = part.contact
    if values.kind == "suction":
        pull = -F[2] if model != "cable" else cp.norm(F[:3])
        if model == "cable":
            up = part.axes.T @ np.array([0.0, 0.0, 1.0])
            tension = cp.Variable()
            return [F[:3] == tension * up, F[3:] == 0, tension >= 0, tension <= values.limit]
        pressed = pull if model == "paper" else values.limit - pull
        return [
            pull >= 0,
            pull <= values.limit,
            math.sqrt(3.0) * cp.abs(F[:2]) <= values.mu * pressed,
            math.sqrt(3.0) * cp.abs(F[5]) <= values.radius * values.mu * pressed,
            math.sqrt(2.0) * cp.abs(F[3:5]) <= math.pi * values.radius * values.kappa,
        ]
    within = [F[3:5] == 0]
    if values.limit is not None and _squeeze(values) is None:
        within.append(F[2] <= values.limit)
    if values.kind == "soft_finger":
        return [*within, cp.norm(cp.hstack([F[0], F[1], F[5] / values.eps])) <= values.mu * F[2]]
    return [*within, F[5] == 0, cp.norm(F[:2]) <= values.mu * F[2]]


def _squeeze(contact: BearingContact) -> float | None:
    return contact.squeeze if contact.kind == "soft_finger" else None


def _parts(contacts: Sequence[BearingContact], model: str) -> list[_Unknowns]:
    parts, begun = [], 0
    for contact in contacts:
        axes, basis = _frame(contact), _basis(contact, model)
        parts.append(_Unknowns(contact, axes, slice(begun, begun + basis.shape[1]), basis))
        begun += basis.shape[1]
    return parts


def _frame(contact: BearingContact) -> Array:
    """Return the axes of a contact: a pad's as stated, others any two square to the normal."""
    z = contact.normal
    if contact.kind == "suction":
        return np.column_stack([contact.x_axis, np.cross(z, contact.x_axis), z])
    return np.column_stack([*_across(z), z])


def _across(normal: Array) -> Array:
    """Return two unit vectors (2, 3) that are square to a normal (3,) and to one another."""
    x = np.cross(np.eye(3)[int(np.argmin(np.abs(normal)))], normal)
    x = x / np.linalg.norm(x)
    return np.array([x, np.cross(normal, x)])


def _basis(contact: BearingContact, model: str) -> Array:
    """Return the wrenches, in the contact's frame, that its unknowns make: (6, k)."""
    if contact.kind == "soft_finger":
        return np.eye(6)[:, [0, 1, 2, 5]]
    if contact.kind != "suction":
        return np.eye(6)[:, :3]
    if model == "cable":
        return np.concatenate([_frame(contact).T @ np.array([0.0, 0.0, 1.0]), np.zeros(3)])[:, None]
    return np.eye(6)


def _pull(part: _Unknowns) -> Array:
    """Return the pull outward, or a cable's tension, as a row over the unknowns."""
    return np.ones(1) if part.basis.shape[1] == 1 else -part.basis[2]


def _grasp_map(part: _Unknowns, reference: Array) -> Array:
    """(2): from a wrench in the contact's frame to world axes about the reference point."""
    R = part.axes
    return np.block([[R, np.zeros((3, 3))], [skew(part.contact.point - reference) @ R, R]])


def _about(part: _Unknowns, reference: Array) -> Array:
    return _grasp_map(part, reference) @ part.basis
