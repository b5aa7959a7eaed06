"""A plan executed where the plate is not as the task says: physics has the real one, the lift aims at the known one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from planners.progress import silent
from workers.simulation.simulate import simulate_lift

HEAVIER = 1.1


@pytest.mark.slow
def test_hands_and_cup_bear_the_actual_plate_and_aim_at_the_known_one(run) -> None:
    plate = run.scene.plate
    actual = replace(run.scene, plate=replace(plate, mass=HEAVIER * plate.mass))
    simulation = simulate_lift(run.plan, run.scene, silent, 3, actual=actual)
    weight = 9.81 * actual.plate.mass
    for node in simulation.manipulation.nodes:
        total = np.sum(list(node.simulated.values()), axis=0)
        assert np.linalg.norm(total - [0.0, 0.0, weight]) < 0.05 * weight
    # What the hands aim at follows from the contacts they have got hold of, and from the weight that they were told.
    assert simulation.lift is not None, simulation.cause
    told = run.simulation.lift.goal_force
    assert simulation.lift.goal_force == pytest.approx(told, rel=0.02)
