"""What a plan wants at every step, against looking each instant up by itself."""

from __future__ import annotations

from itertools import islice

import numpy as np

from tests.simulation.conftest import Run
from workers.simulation.lift_reference import LiftReference

STEP = 0.002


def test_instants_looked_up_together_are_those_looked_up_one_by_one(run: Run) -> None:
    reference = LiftReference(run.plan, run.scene.cup.T_plate_cup[:3, 3])
    time, beyond = 0.0, round(reference.duration / STEP) + 600
    for together in islice(reference.every(STEP), beyond):
        alone = reference.at(time)
        assert together[:6] == alone[:6]
        assert np.array_equal(together.row, alone.row, equal_nan=True)
        time += STEP
    assert time > reference.duration
