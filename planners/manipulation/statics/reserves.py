"""How much of every limit a plan leaves: the largest share by which friction, hands and cup may all be weaker."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from planners.balance.balanced import Balanced, HeldPlate, Unbalanced
from planners.balance.lifter import SuctionPad
from planners.balance.solver import Balance
from planners.geometry.pose import Array
from planners.manipulation.lift_segment import BalancedContacts, LiftSegment
from planners.plan.verdicts import LeastReserve

STEPS = 200
"""A reserve is found as a whole multiple of one part in so many [1]."""
JOINTS = "joints, which would not bear forces that keep more back"
"""Name of the limit that is none of forces."""
_ROUNDING = 1e-9
"""Of a number of steps [1]."""


class ReserveScale:
    """Finds reserves by bisection: what can be held with one can be held with any smaller one."""

    def __init__(self, program: Balance) -> None:
        """Take a program with nothing kept back."""
        self._program = program
        self._known: dict[int, Balance] = {}
        self._last = STEPS // 2

    def forces_keeping_most(self, planned: Balanced, reserve: float) -> tuple[float, Balanced]:
        """Return the largest share of every limit that can be kept back, rounded down to a step, and forces with it.

        Args:
            planned: forces that keep `reserve`; they are returned where no step more can be kept.
            reserve: [1].
        """
        low, high, best = int(reserve * STEPS), STEPS, planned
        # Neighbouring contact sets keep about as much: the last one's is where to begin, in steps that double.
        middle, stride = self._last, 1
        while high - low > 1:
            middle = min(max(middle, low + 1), high - 1)
            answer = _answer(self._keeping(middle), planned.held)
            if isinstance(answer, Balanced):
                low, best = middle, answer
                middle = low + stride
            else:
                high = middle
                middle = high - stride
            stride *= 2
            if not low < middle < high:
                middle = (low + high) // 2
        self._last = low
        return max(low / STEPS, reserve), best

    def limit(self, held: HeldPlate, reserve: float) -> str:
        """Name the limit that keeps the reserve from being larger: the one whose own share need not be kept back.

        Where no limit of forces does, joints would not bear the forces that keep more back.
        """
        beyond = math.floor(reserve * STEPS + _ROUNDING) + 1
        kept = self._keeping(min(beyond, STEPS - 1))
        if beyond < STEPS and isinstance(_answer(kept, held), Balanced):
            return JOINTS
        for name, program in _each_relaxed(self._program, kept, held):
            if isinstance(_answer(program, held), Balanced):
                return name
        return "several limits together"

    def _keeping(self, steps: int) -> Balance:
        if steps not in self._known:
            self._known[steps] = self._program.keeping_back(steps / STEPS)
        return self._known[steps]


def _answer(program: Balance, held: HeldPlate) -> Balanced | Unbalanced:
    return program.solve(held.rotation_world_plate, held.environment_points, held.grip, held.push)


def _each_relaxed(stated: Balance, kept: Balance, held: HeldPlate) -> Iterable[tuple[str, Balance]]:
    """Yield programs with all shares kept back but one limit's, with the name of that limit."""
    whole, less = stated.cup, kept.cup
    pull = "cup: pull", kept.with_limits(cup=replace(less, max_force=whole.max_force))
    friction = "cup: friction", kept.with_limits(cup=replace(less, mu=whole.mu))
    # Where friction grows with the cup's force (Dex-Net), more of that force may be wanted for friction alone.
    grows = isinstance(stated.lifter, SuctionPad) and stated.lifter.grip_at_rest > 0.0
    yield from (friction, pull) if grows else (pull, friction)
    yield "cup: bending", kept.with_limits(cup=replace(less, kappa=whole.kappa))
    if held.grip is not None:
        yield "friction of the fingers", kept.with_limits(friction=replace(kept.friction, grip=stated.friction.grip))
        limits = replace(kept.limits, grip=stated.limits.grip, normal=stated.limits.normal, push=kept.limits.push)
        yield "what the gripping hand may bear", kept.with_limits(limits=limits)
    if held.push is not None:
        yield "friction of the stick", kept.with_limits(friction=replace(kept.friction, push=stated.friction.push))
        limits = replace(kept.limits, push=stated.limits.push, normal=stated.limits.normal)
        yield "what the pushing hand may bear", kept.with_limits(limits=limits)
    if len(held.environment_points):
        friction = replace(kept.friction, environment=stated.friction.environment)
        yield "friction of what the plate stands on", kept.with_limits(friction=friction)


@dataclass(frozen=True, eq=False)
class ReservedSegments:
    """The segments of a plan with forces that keep as much back as there can be, and how much that is."""

    segments: tuple[LiftSegment, ...]
    samples: tuple[Array, ...]
    """For each segment (n,) the reserve at its samples [1]; NaN where no hand is on the plate."""
    least: LeastReserve | None
    """None: the plate is never held."""


def keeping_most(
    segments: Sequence[LiftSegment],
    program: Balance,
    planned: float,
    bearable: Callable[[LiftSegment, BalancedContacts], bool],
) -> ReservedSegments:
    """Choose at every contact set the forces that are farthest from all limits; of these, those of least effort (5a).

    A plan is searched with forces of least effort, which lie on the limits that are kept in the search. When it is
    executed it is better to be as far from all limits as there is room. Between two contact sets the reserve is taken
    to change evenly.

    Args:
        segments: of a plan, with forces that keep the planned reserve.
        program: (5) with nothing kept back.
        planned: the reserve that was kept in planning [1].
        bearable: whether the arms' joints bear the forces of a contact set; else those planned are kept.
    """
    scale, known = ReserveScale(program), dict[int, tuple[float, Balanced]]()
    chosen, curves = list[LiftSegment](), list[Array]()
    least: tuple[float, int, int, HeldPlate] | None = None
    for number, segment in enumerate(segments):
        curve, time = np.full(len(segment.trajectory.time), np.nan), segment.trajectory.time
        if segment.grip is not None or segment.push is not None:
            sets, values = list[BalancedContacts](), list[float]()
            for each in segment.contact_sets:
                # Where the plate rests many sets share one answer.
                if id(each.balance) not in known:
                    known[id(each.balance)] = scale.forces_keeping_most(each.balance, planned)
                value, balance = known[id(each.balance)]
                better = BalancedContacts(each.sample, balance)
                if not bearable(segment, better):
                    value, better = planned, each
                sets.append(better)
                values.append(value)
                if least is None or value < least[0]:
                    least = value, number, each.sample, each.balance.held
            curve = np.interp(time, time[[each.sample for each in sets]], values)
            segment = replace(segment, contact_sets=tuple(sets))
        chosen.append(segment)
        curves.append(curve)
    if least is None:
        return ReservedSegments(tuple(chosen), tuple(curves), None)
    value, number, sample, held = least
    limit = scale.limit(held, value)
    told = LeastReserve(value=value, limited_by=limit, body="plate", segment=number, sample=sample)
    return ReservedSegments(tuple(chosen), tuple(curves), told)
