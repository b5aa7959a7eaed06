"""Controllers for the arms of a plan."""

from __future__ import annotations

import numpy as np

from planners.plan.scenery import ARMS
from planners.program.schedule import Schedule

from .controller import Configuration
from .stand_in import hosts

CYCLE = 0.002
"""Of an e-Series' controller [s]."""
HARDEST = 100.0
"""No joint may change its speed by more: a program's own stop takes 40 [rad/s²]."""


def configurations(schedule: Schedule) -> list[Configuration]:
    """Return what the controllers of both arms are told at their start: where the plan begins, and its cell's limits.

    Args:
        schedule: that begins where the arms stand.
    """
    arms = schedule.plan.cell.arms
    return [
        Configuration(
            host=hosts()[arm],
            start=schedule.start[arm].tolist(),
            position_min=arms[arm].position_min.tolist(),
            position_max=arms[arm].position_max.tolist(),
            velocity_max=arms[arm].velocity_max.tolist(),
            acceleration_max=[HARDEST] * 6,
            dh=np.asarray(arms[arm].dh).tolist(),
            cycle=CYCLE,
        )
        for arm in ARMS
    ]
