"""F_goal of eq. (11): which forces the hands should bear while the plate is lifted, from program (5)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planners.balance.balanced import Balanced
from planners.balance.contacts import GripContacts, PushContact
from planners.geometry.pose import Array
from planners.manipulation.statics.lift_programs import balance_program
from planners.scene.lift_scene import PlateLiftScene

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


def lift_goal(
    scene: PlateLiftScene,
    rotation_world_plate: Array,
    grip: GripContacts,
    push: PushContact,
) -> LiftGoal | None:
    """Solve (5) for the plate in the air with as large a reserve as there can be: on the cup, then on all limits.

    The cup is the first that a fast lifter takes to its limit. What friction keeps back keeps the hands from sliding
    when the lifter stops.

    Args:
        scene: plate, cup, friction and limits.
        rotation_world_plate: (3, 3).
        grip: contacts of the gripping hand, plate frame.
        push: contact of the pushing hand, plate frame.

    Returns:
        The goal, or None if the hands and the cup do not bear the plate even without reserve.
    """

    def bears(reserve: float, cup_reserve: float) -> LiftGoal | None:
        program = balance_program(scene, cup_reserve, reserve)
        answer = program.solve(rotation_world_plate, np.empty((0, 3)), grip, push)
        return LiftGoal(answer, reserve, cup_reserve) if isinstance(answer, Balanced) else None

    found = next((goal for cup_reserve in RESERVES if (goal := bears(0.0, cup_reserve))), None)
    if found is None:
        return None
    both = (reserve for reserve in RESERVES if 0.0 < reserve <= found.cup_reserve)
    return next((goal for reserve in both if (goal := bears(reserve, found.cup_reserve))), found)
