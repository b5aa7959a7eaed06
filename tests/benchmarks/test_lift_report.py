"""What the report on simulated lifts must ask for. No figure is asserted."""

from __future__ import annotations

import pytest

from tests.benchmarks.bench_simulation import LiftFigures, SimulationFigures
from tests.benchmarks.lift_report import lift_limits, lift_sections

LIFT = {"height": 0.2, "reachable_height": 0.215, "end_of_reach": "nothing", "cup_reserve": 0.2}


def figures_of(off: float) -> list[SimulationFigures]:
    """One lift of two tasks; in the second a hand that is to bear 10 N bears so much more [N]."""
    return [SimulationFigures(task, 40.0, [lift(force)]) for task, force in (("ab1", 0.0), ("pb1", off))]


def lift(off: float) -> LiftFigures:
    planned = {"left": [0.0, 0.0, 10.0], "right": [0.0, 0.0, 10.0], "cup": [0.0, 0.0, 20.0], "support": [0.0, 0.0, 0.0]}
    simulated = planned | {"left": [0.0, 0.0, 10.0 + off]}
    node = {"planned": planned, "simulated": simulated, "largest_difference": off}
    run = {
        "outcome": "lifted", "lift": LIFT, "dips": {"count": 0, "seconds": 0.0, "longest": 0.0},
        "manipulation": {"nodes": [node]},
    }  # fmt: skip
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
