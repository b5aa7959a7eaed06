"""A plan of two arms that go to and fro, to be executed by controllers and gone back along."""

from __future__ import annotations

import numpy as np

from planners.cell.cell import load_cell
from planners.contract.arrays import ArmName
from planners.plan.plan import Plan
from planners.plan.scenery import ARMS
from tests.support.documents import plan_of
from tests.support.lift_documents import lift_document, segment

START = np.array([0.2, -1.2, -1.6, -2.0, 1.5, 0.3, -0.2, -1.9, 1.6, -1.1, -1.5, 0.1])
WAYS = np.array([0.5, -0.3, 0.4, 0.6, -0.5, 0.8, -0.4, 0.3, -0.5, 0.2, 0.6, -0.7])
MOVERS: tuple[list[ArmName], ...] = (["left", "right"], ["left"], ["right"], ["left", "right"])
DURATION = 0.8
"""Of each step [s]."""
CHECK = {"name": "structure", "passed": True, "margin": 0.0, "unit": "1", "where": "the whole document"}


def moving_plan(movers: tuple[list[ArmName], ...] = MOVERS) -> Plan:
    """Return a plan whose arms go to and fro, a segment each way, from rest to rest as half a period of a cosine."""
    time_ = np.linspace(0.0, DURATION, 41)
    rate = np.pi / DURATION
    shape, speed = (1 - np.cos(rate * time_)) / 2, np.sin(rate * time_) * rate / 2
    acceleration = np.cos(rate * time_) * rate**2 / 2
    q, segments = START.copy(), []
    for index, names in enumerate(movers):
        way = np.where(np.repeat([arm in names for arm in ARMS], 6), WAYS * (-1) ** index, 0.0)
        rows = {
            "positions": q + np.outer(shape, way),
            "velocities": np.outer(speed, way),
            "accelerations": np.outer(acceleration, way),
        }
        rows = {name: values.tolist() for name, values in rows.items()}
        segments.append(
            segment(0.0, 41, **{"movers": list(names), "time": (time_ + index * DURATION).tolist(), **rows})
        )
        q = q + way
    certificate = {"passed": True, "checks": [CHECK]}
    cell = load_cell("dual_ur3e_lift")
    members = {"outcome": "solved", "segments": segments, "certificate": certificate}
    return plan_of({**lift_document(cell), **members})
