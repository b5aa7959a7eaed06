"""What rests stands, everything together, whenever a hand or the cup has taken or left something.

Bodies stand if upward forces where level faces meet, and where points stand on level faces, balance every one of them
under its weight and under what rests on it. Friction, walls and faces that are not level are left out: they could only
hold what is found to fall here. Contacts reach out over true ones by no more than the corners of a polygon around a
circle, 0.12 % of its radius.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.optimize import linprog

from planners.certify.evidence import Evidence
from planners.certify.finding import Finding
from planners.certify.geometry.level_contacts import LevelFaces, contact_points
from planners.certify.plan_view import BodyView, PlanView
from planners.certify.tool.task import TOOL
from planners.certify.tool.tool_states import StateChange, ToolState
from planners.geometry.pose import Array, Transform
from planners.plan.verdicts import Check

_SHIFT = 1e-4
"""Bodies count as standing if shifting centres of mass by so much would make them stand: a tenth of what objects may be
off their goals [m]."""
_MOVES = 1e-9
"""Dual value below which a body has no part in a fall [1]."""


def standing_check(evidence: Evidence, steps: Sequence[StateChange]) -> Check:
    """Check that what is in no hand and on no cup stands: at the start, and once hand or cup took or left something."""
    plan, finding = evidence.plan, Finding("standing", "m")
    piles = _Piles(plan, evidence.settings.contact_distance)
    if steps:
        poses = {name: body.T_world_start for name, body in plan.bodies.items()}
        piles.note(_free(plan, steps[0].before), poses, finding, "the start")
    for motion, step in zip(evidence.motions, steps, strict=True):
        if (step.before.hands, step.before.sucked) != (step.after.hands, step.after.sucked):
            poses = {name: poses[-1] for name, poses in motion.body_poses.items()}
            piles.note(_free(plan, step.after), poses, finding, f"{step.segment.place()}, end")
    return finding.check()


def _free(plan: PlanView, state: ToolState) -> list[BodyView]:
    held = {state.sucked, TOOL if state.hands else None}
    return [body for body in plan.bodies.values() if not body.static and body.name not in held]


@dataclass(eq=False)
class _Piles:
    """Contacts and forces of bodies at rest; what was found once is not looked for again."""

    plan: PlanView
    touch: float
    """Level faces that are no farther apart in height touch [m]."""
    _faces: dict[tuple[str, bytes], LevelFaces] = field(default_factory=dict)
    _contacts: dict[tuple[str, bytes, str, bytes], Array] = field(default_factory=dict)
    _shifts: dict[frozenset[tuple[str, bytes]], tuple[float, tuple[str, ...]]] = field(default_factory=dict)

    def note(self, free: Sequence[BodyView], poses: Mapping[str, Transform], finding: Finding, where: str) -> None:
        """Note by how much each pile of free bodies stands or falls."""
        free_names = {body.name for body in free}
        carriers = [body.name for body in self.plan.bodies.values() if body.static or body.name in free_names]
        contacts = {
            (body.name, below): points
            for body in free
            for below in carriers
            if below != body.name and len(points := self._between(body.name, below, poses))
        }
        for pile in _piles(free, contacts):
            key = frozenset((body.name, poses[body.name].tobytes()) for body in pile)
            if key not in self._shifts:
                own = {pair: points for pair, points in contacts.items() if pair[0] in {body.name for body in pile}}
                self._shifts[key] = least_shift(pile, poses, own)
            shift, falling = self._shifts[key]
            told = f"{where}: {' and '.join(falling) or pile[0].name}"
            finding.note(_SHIFT - shift, told if shift <= _SHIFT else f"{told} would fall")

    def _between(self, name: str, below: str, poses: Mapping[str, Transform]) -> Array:
        """Return the points (k, 2) at which one body stands on another."""
        key = (name, poses[name].tobytes(), below, poses[below].tobytes())
        if key not in self._contacts:
            upper, lower = self._level(name, poses[name]), self._level(below, poses[below])
            apart = np.any((upper.low > lower.high + self.touch) | (lower.low > upper.high + self.touch))
            self._contacts[key] = np.empty((0, 2)) if apart else contact_points(upper, lower, self.touch)
        return self._contacts[key]

    def _level(self, name: str, T_world_body: Transform) -> LevelFaces:
        key = name, T_world_body.tobytes()
        if key not in self._faces:
            self._faces[key] = LevelFaces(self.plan.bodies[name].shape, T_world_body)
        return self._faces[key]


def _piles(free: Sequence[BodyView], contacts: Mapping[tuple[str, str], Array]) -> Iterator[list[BodyView]]:
    """Yield the bodies that are joined by standing on one another."""
    left = {body.name: body for body in free}
    while left:
        pile, new = [], [next(iter(left))]
        while new:
            name = new.pop()
            if name in left:
                pile.append(left.pop(name))
                new += [other for pair in contacts if name in pair for other in pair]
        yield pile


def least_shift(
    pile: Sequence[BodyView], poses: Mapping[str, Transform], contacts: Mapping[tuple[str, str], Array]
) -> tuple[float, tuple[str, ...]]:
    """Return how far centres of mass have to be shifted for a pile to stand [m], and the bodies that fall.

    It is the least s for which forces f >= 0, in multiples of g, bear the weight of every body, with moments about its
    centre of mass of no more than its weight times s, along x and along y. Infinite where something stands on nothing.
    """
    numbers = {body.name: i for i, body in enumerate(pile)}
    masses = np.array([max(body.mass or 0.0, 1e-9) for body in pile])
    centres = np.array([(poses[body.name] @ [*body.com, 1.0])[:2] for body in pile])
    columns = []
    for (name, below), points in contacts.items():
        for point in points:
            column = np.zeros((len(pile), 3))
            for body, sign in ((name, 1.0), (below, -1.0)):
                if body in numbers:
                    i = numbers[body]
                    column[i] = sign / masses[i] * np.array([1.0, *(point - centres[i])])
            columns.append(column)
    hanging = tuple(body.name for body in pile if not any(name == body.name for name, _ in contacts))
    if hanging:
        return math.inf, hanging
    stacked = np.array(columns)
    force, moments = stacked[:, :, 0].T, stacked[:, :, 1:].reshape(len(columns), -1).T
    with_shift = np.column_stack([np.vstack([moments, -moments]), -np.ones(2 * len(moments))])
    answer = linprog(
        np.append(np.zeros(len(columns)), 1.0),
        A_ub=with_shift,
        b_ub=np.zeros(len(with_shift)),
        A_eq=np.column_stack([force, np.zeros(len(pile))]),
        b_eq=np.ones(len(pile)),
    )
    if not answer.success:
        return math.inf, tuple(body.name for body in pile)
    turning = np.abs(answer.ineqlin.marginals).reshape(2, len(pile), 2).max(axis=(0, 2))
    return float(answer.fun), tuple(body.name for body, part in zip(pile, turning, strict=True) if part > _MOVES)
