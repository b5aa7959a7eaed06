"""What the report on simulated lifts must ask for. No figure is asserted."""

from __future__ import annotations

import numpy as np
import pytest

from planners.plan.simulation import ForceDips, LiftSimulation, NodeComparison, SimulatedLift, SimulatedManipulation
from tests.benchmarks.bench_simulation import LiftFigures, SimulationFigures
from tests.benchmarks.lift_report import lift_limits, lift_sections

LIFT = SimulatedLift(
    begin=10.0, height=0.2, reachable_height=0.215, end_of_reach="nothing", goal_force=10.0, cup_reserve=0.2,
    lifter_travel=0.2, lifter_seconds=5.0, controlled=True,
)  # fmt: skip
LOADS = {"left": 10.0, "right": 10.0, "cup": 20.0, "support": 0.0}
"""Upward on the plate, as planned [N]."""


def figures_of(off: float) -> list[SimulationFigures]:
    """One lift of two tasks; in the second a hand that is to bear 10 N bears so much more [N]."""
    return [SimulationFigures(task, 40.0, [lift(force)]) for task, force in (("ab1", 0.0), ("pb1", off))]


def lift(off: float) -> LiftFigures:
    planned = {name: np.array([0.0, 0.0, up]) for name, up in LOADS.items()}
    simulated = planned | {"left": np.array([0.0, 0.0, LOADS["left"] + off])}
    node = NodeComparison(segment=1, time=2.0, planned=planned, simulated=simulated, largest_difference=off)
    compared = SimulatedManipulation.model_construct(nodes=[node])
    dips = ForceDips(count=0, seconds=0.0, lowest=None)
    run = LiftSimulation.model_construct(outcome="lifted", lift=LIFT, dips=dips, manipulation=compared)
    return LiftFigures(0, run, run, 0.2)


@pytest.mark.parametrize(("off", "kept"), [(0.5, True), (30.0, False)])
def test_forces_at_nodes_are_asked_to_be_what_was_planned_but_for_what_the_model_is_told_to_do_wrong(
    off: float, kept: bool
) -> None:
    figures = figures_of(off)
    (limit,) = [limit for limit in lift_limits(figures) if "planned force" in limit.what]
    assert limit.kept == kept
    assert "pb1" in limit.reached
    assert ("unexplained: pb1" in "".join(lift_sections(figures, {}))) == (not kept)
