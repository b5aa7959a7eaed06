"""F_goal of eq. (11): which forces the hands should bear while the plate is lifted, from program (5)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from planners.balance.balanced import Balanced
from planners.balance.contacts import GripContacts, PushContact
from planners.geometry.pose import Array
from planners.manipulation.groundwork import balance_program
from planners.scene.scene import PlateLiftScene

CUP_RESERVES = (0.2, 0.15, 0.1, 0.05, 0.0)
"""Parts of the cup's largest force that are kept back for the lifter's jerks; the first that is possible is taken."""


@dataclass(frozen=True, eq=False)
class LiftGoal:
    """The forces to hold while lifting."""

    balance: Balanced
    """Least-effort wrenches (5) with the cup's limit lowered by the reserve."""
    cup_reserve: float
    """Part of the cup's largest force that (5) was not allowed to use [1]."""


def lift_goal(
    scene: PlateLiftScene,
    rotation_world_plate: Array,
    grip: GripContacts,
    push: PushContact,
    reserves: Sequence[float] = CUP_RESERVES,
) -> LiftGoal | None:
    """Solve (5) for the plate in the air with as large a reserve on the cup as there can be.

    Args:
        scene: plate, cup, friction and limits.
        rotation_world_plate: (3, 3).
        grip: contacts of the gripping hand, plate frame.
        push: contact of the pushing hand, plate frame.
        reserves: to try, largest first.

    Returns:
        The goal, or None if the hands and the cup do not bear the plate even without reserve.
    """
    for reserve in reserves:
        answer = balance_program(scene, reserve).solve(rotation_world_plate, np.empty((0, 3)), grip, push)
        if isinstance(answer, Balanced):
            return LiftGoal(answer, reserve)
    return None
