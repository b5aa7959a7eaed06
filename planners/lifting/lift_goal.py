"""F_goal of eq. (11): which forces the hands should bear while the plate is lifted, from program (5)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from planners.balance.balanced import Balanced
from planners.balance.contacts import GripContacts, PushContact
from planners.balance.solver import Balance
from planners.geometry.pose import Array
from planners.manipulation.statics.lift_programs import keeping_back

RESERVES = tuple(percent / 100.0 for percent in range(20, -1, -1))
"""Parts of limits that are kept back for the lifter's jerks; the first that is possible is taken."""


@dataclass(frozen=True, eq=False)
class LiftGoal:
    """The forces to hold while lifting."""

    balance: Balanced
    """Least-effort wrenches (5) with all limits lowered by the reserve, and the cup's by its own."""
    reserve: float
    """Share of every limit, friction among them, that (5) was not allowed to use; no more than the cup's [1]."""
    cup_reserve: float
    """Part of the cup's largest force likewise [1]."""
    push_share: float
    """Part of its largest normal force that the stick presses with at least [1]."""


def lift_goal(stated: Balance, rotation_world_plate: Array, grip: GripContacts, push: PushContact) -> LiftGoal | None:
    """Solve (5) for the plate in the air as far from all limits as can be: the cup's, then all, then a push of nothing.

    The cup is the first that a fast lifter takes to its limit. What friction keeps back keeps the hands from sliding
    when the lifter stops. A stick that hardly presses is lost at the first jerk, and least effort does not care; so of
    forces that keep equally much back those are taken where it presses hardest, up to the same share of its range.

    Args:
        stated: program (5) of the plate with nothing kept back.
        rotation_world_plate: (3, 3).
        grip: contacts of the gripping hand, plate frame.
        push: contact of the pushing hand, plate frame.

    Returns:
        The goal, or None if the hands and the cup do not bear the plate even without reserve.
    """

    def bears(reserve: float, cup_reserve: float, share: float = 0.0) -> LiftGoal | None:
        program = keeping_back(stated, cup_reserve, reserve)
        if share > 0.0:
            program = program.with_limits(limits=replace(program.limits, least_push=share * stated.limits.pushing))
        answer = program.solve(rotation_world_plate, np.empty((0, 3)), grip, push)
        return LiftGoal(answer, reserve, cup_reserve, share) if isinstance(answer, Balanced) else None

    def first(goals: Iterator[LiftGoal | None], otherwise: LiftGoal) -> LiftGoal:
        return next((goal for goal in goals if goal is not None), otherwise)

    found = next((goal for cup_reserve in RESERVES if (goal := bears(0.0, cup_reserve))), None)
    if found is None:
        return None
    kept = found.cup_reserve
    found = first((bears(reserve, kept) for reserve in RESERVES if 0.0 < reserve <= kept), found)
    return first((bears(found.reserve, kept, share) for share in RESERVES if share > 0.0), found)
