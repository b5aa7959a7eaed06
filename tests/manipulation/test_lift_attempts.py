"""What is tried before a lift counts as not found, and how much of every limit is kept back."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import pytest

from planners.cell.cell import Cell, load_cell
from planners.contract.task_spec import PlateLiftTask, read_task
from planners.manipulation.lift_attempts import plan_lift
from planners.manipulation.lift_plan import LiftPlan
from planners.plan.verdicts import PlanningOutcome
from planners.planning import lift_settings
from planners.progress import silent
from planners.scene.scene import build_scene
from tests.manipulation.lift_probe import planner_of, task_body


@pytest.fixture(scope="module")
def cells() -> dict[str, Cell]:
    return {"dual_ur3e_lift": load_cell("dual_ur3e_lift")}


def planned(body: dict[str, Any], cells: dict[str, Cell]) -> LiftPlan:
    task = read_task(body)
    assert isinstance(task, PlateLiftTask)
    return plan_lift(build_scene(task, cells), lift_settings(task.options), silent)


@pytest.fixture(scope="module")
def ab1(cells) -> LiftPlan:
    return planned(task_body("ab1", reserve=0.1), cells)


def test_a_lift_without_the_reserve_asked_for_keeps_as_much_as_there_is(ab1: LiftPlan, cells: dict[str, Cell]) -> None:
    """No plan is found with a step or two more, and the summary says what there is."""
    assert ab1.outcome is PlanningOutcome.SOLVED
    assert ab1.reserve is not None
    kept = ab1.reserve.value
    assert 0.0 < kept < 0.1
    assert f"{100 * kept:.1f} %" in ab1.summary
    assert ab1.reserve.limited_by in ab1.summary
    more = planner_of(task_body("ab1", reserve=kept + 0.02), cells).plan()
    assert more.outcome is PlanningOutcome.NOT_FOUND


def test_the_smallest_reserve_of_the_samples_is_the_plans(ab1: LiftPlan) -> None:
    assert ab1.reserve is not None
    assert ab1.reserves is not None
    curve = ab1.reserves.samples[ab1.reserve.segment]
    assert curve[ab1.reserve.sample] == ab1.reserve.value
    held = [samples for samples in ab1.reserves.samples if not math.isnan(samples[0])]
    assert min(samples.min() for samples in held) == ab1.reserve.value


def test_the_risk_is_not_larger_where_it_is_minimised(cells: dict[str, Cell]) -> None:
    careful, plain = (planned(task_body("pb1", minimise=what, reserve=0.1), cells) for what in ("risk", "cost"))
    assert careful.reserve is not None
    assert plain.reserve is not None
    assert careful.reserve.value >= plain.reserve.value >= 0.1


@pytest.mark.slow
def test_a_lift_that_needs_more_holds_is_found_without_being_asked_for_them(cells: dict[str, Cell]) -> None:
    """AB1 turned by 20 degrees has no plan among the first holds, with nothing kept back."""
    body = task_body("ab1", reserve=0.1)
    half = math.radians(10.0)
    body["plate_pose"][3:] = [math.cos(half), 0.0, 0.0, math.sin(half)]
    assert planner_of({**body, "options": {"reserve": 0.0}}, cells).plan().outcome is PlanningOutcome.NOT_FOUND
    assert planned(body, cells).outcome is PlanningOutcome.SOLVED


@pytest.mark.slow
def test_what_only_tolerances_stand_against_is_told_so(cells: dict[str, Cell]) -> None:
    body = task_body("ab3", reserve=0.1)
    body["plate"] = {**body["plate"], "mass_tolerance": 0.02, "com_tolerance": 0.005}
    plan = planned(body, cells)
    assert plan.outcome is PlanningOutcome.NOT_FOUND
    assert "plate.com_tolerance" in plan.summary
    body["plate"] = {**body["plate"], "mass_tolerance": 0.0, "com_tolerance": 0.0}
    assert planned(body, cells).outcome is PlanningOutcome.SOLVED


def test_what_speaks_against_a_reserve_leaves_no_plan_that_keeps_it(ab1: LiftPlan, cells: dict[str, Cell]) -> None:
    """The exhaustive search is the authority: it finds none where something speaks against one, and one elsewhere."""
    assert ab1.reserve is not None
    kept = ab1.reserve.value
    planner = planner_of(task_body("ab1"), cells)
    planner.begin()
    for reserve in (kept + 0.01, kept, kept + 0.005):
        searched = planner_of(task_body("ab1", reserve=reserve), cells)
        found = searched.planned(searched.begin(), low=False, explained=False).outcome is PlanningOutcome.SOLVED
        assert planner.may_keep(reserve, low=False) == found


def test_a_graph_that_does_not_fit_into_memory_is_thinned_and_that_is_told(cells: dict[str, Cell]) -> None:
    task = read_task(task_body("pb1", reserve=0.0))
    assert isinstance(task, PlateLiftTask)
    scene, settings = build_scene(task, cells), lift_settings(task.options)
    edges = planner_of(task_body("pb1", reserve=0.0), cells).reach.edge_count
    small = replace(settings, largest_graph=edges // 2)
    plan = plan_lift(scene, small, silent)
    assert f"{edges} edges" in plan.summary
    assert plan.graph["edges"] <= small.largest_graph
    assert "edges, and" not in plan_lift(scene, replace(settings, largest_graph=edges), silent).summary


def test_a_graph_of_which_too_little_fits_is_not_thinned(cells: dict[str, Cell]) -> None:
    task = read_task(task_body("pb1", reserve=0.0))
    assert isinstance(task, PlateLiftTask)
    tiny = replace(lift_settings(task.options), largest_graph=1)
    plan = plan_lift(build_scene(task, cells), tiny, silent)
    assert plan.outcome is PlanningOutcome.NOT_FOUND
    assert "simplify the plate's outline" in plan.summary
