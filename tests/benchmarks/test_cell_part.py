"""What the part on cells must not leave out, and what its draws keep to. No figure is asserted."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from planners.cell.cell import load_cells
from tests.benchmarks.cell_part import CellFigures, _limits, _outcomes, _physics, _reasons
from tests.benchmarks.cell_tasks import CUP_SHIFT, EXAMPLES, CellAttempt, accepted
from tests.benchmarks.tasks import task_body


def attempts(cell: str, planning: float, *outcomes: str) -> CellFigures:
    made = [
        CellAttempt(cell, EXAMPLES[cell], seed, outcome, "" if outcome == "solved" else f"box_{seed} is {seed} mm off",
                    planning_cpu=planning)
        for seed, outcome in enumerate(outcomes)
    ]  # fmt: skip
    return CellFigures(cell, made)


def test_every_shipped_cell_has_an_example_in_it() -> None:
    assert set(EXAMPLES) == set(load_cells())
    for cell, example in EXAMPLES.items():
        assert task_body(example).get("cell", cell) == cell


@pytest.mark.slow
def test_a_seed_draws_one_accepted_task_near_the_example() -> None:
    cells = load_cells()
    for cell, example in EXAMPLES.items():
        shipped = task_body(example)
        body, _ = accepted(cells, cell, example, 3)
        assert body == accepted(cells, cell, example, 3)[0] != accepted(cells, cell, example, 4)[0]
        if body["kind"] == "plate_lift":
            places = (
                np.array(each["cup"]["position"]) / each["plate"]["shape"]["size"][:2] for each in (body, shipped)
            )
            assert float(np.abs(np.subtract(*places)).max()) <= CUP_SHIFT + 1e-3
        else:
            assert [each["goal_pose"] for each in body["objects"]] == [each["goal_pose"] for each in shipped["objects"]]


def test_what_is_not_solved_is_told_by_reason_and_what_may_not_happen_by_number() -> None:
    figures = [
        attempts("dual_ur3e_tool", 1.0, "solved", "solved"),
        attempts("dual_ur5e_tool", 3.0, "not_found", "not_found", "certificate failed"),
    ]
    broken, slower = _limits(figures)
    assert (broken.reached, broken.kept) == (1, False)
    assert not slower.kept
    assert "| dual_ur5e_tool | not found | box is … mm off | 2 |" in _reasons(figures)
    assert "| dual_ur5e_tool | carton_pile | 0 | 3 | 0 (0 %) | 0 (0 %) | 2 (67 %) | 1 (33 %) |" in _outcomes(figures)


def test_of_plans_that_were_executed_those_that_fail_are_told_one_by_one() -> None:
    lifts = attempts("dual_ur3e_lift", 1.0, "solved", "solved", "solved", "not_found")
    first, second, *untried = lifts.attempts
    tried = [replace(first, physics=""), replace(second, physics="the stick slid"), *untried]
    told = _physics([replace(lifts, attempts=tried), attempts("dual_ur3e_tool", 1.0, "solved")])
    assert "| dual_ur3e_lift | 2 | 1 (50 %) |" in told
    assert "| dual_ur3e_lift | 1 | the stick slid |" in told
    assert "dual_ur3e_tool" not in told
