"""What is tried before a lift counts as not found, and how much of every limit is kept back."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from planners.balance.balanced import Balanced
from planners.cell.cell import Cell, load_cell
from planners.contract.task_spec import PlateLiftTask, read_task
from planners.manipulation.lift_attempts import plan_lift
from planners.manipulation.lift_plan import LiftPlan
from planners.manipulation.planner import PlateLiftPlanner
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


@pytest.mark.slow
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


@pytest.mark.slow
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


@pytest.mark.slow
def test_where_not_even_the_plate_as_stated_may_be_held_there_is_no_plan_for_it(cells: dict[str, Cell]) -> None:
    """The exhaustive search is the authority, for a lift that can be done and for one that cannot."""
    for name in ("ab1", "pb1_weak_cup"):
        planner = planner_of(task_body(name), cells)
        may = planner.may_hold_as_stated()
        planner.balance = planner.sampling.balance(0.0, tolerances=False)
        exhaustive = planner.planned(planner.begin(), explained=False).outcome
        assert may == (exhaustive is PlanningOutcome.SOLVED)
        assert planner.plan_as_stated().outcome is exhaustive


@pytest.mark.slow
def test_what_proofs_of_another_sampling_leave_out_is_not_held(cells: dict[str, Cell]) -> None:
    """Program (5) is the authority, asked at nodes that are left out. The cheapest way of the others is the same."""
    body = task_body("ab1", hold_density=0.5)
    coarse = planner_of(body, cells)
    coarse.may_keep(0.0, low=True)
    assert coarse.balance.telling_proofs
    whole, settings = planner_of(task_body("ab1"), cells), coarse.settings.scaled(1.0, 2.0)
    pruned = PlateLiftPlanner(whole.scene, settings, silent, None, coarse.balance.telling_proofs)
    assert pruned.reach.edge_count < whole.reach.edge_count
    out = np.argwhere(pruned.balance.ruled_out)
    for pose, *rows in np.random.default_rng(3).choice(out, 40):
        hands = tuple(None if row == 0 else int(row) - 1 for row in rows)
        asked = whole.balance.poses.poses[pose]
        held = isinstance(whole.balance.solve(asked.T_world_plate, asked.contact_points, hands), Balanced)
        assert not held or whole.balance.refusal(asked.T_world_plate, asked.contact_points, hands) is not None
    whole.balance.learn(coarse.balance.telling_proofs)
    searches = [each.begin(()) for each in (whole, pruned)]
    for search in searches:
        assert search.best_path() is not None
    cheapest = [min(path.cost for path in search.paths.values() if path is not None) for search in searches]
    assert cheapest[0] == cheapest[1]


@pytest.mark.slow
def test_densities_rise_as_long_as_graphs_fit_and_there_is_hope(
    cells: dict[str, Cell], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each try has more poses and holds than the one before; with no hope after twice as many, that was all."""
    body = task_body("ab3", reserve=0.1, contact_density=0.5, hold_density=0.5)
    body["plate"] = {**body["plate"], "mass_tolerance": 0.02, "com_tolerance": 0.005}
    task = read_task(body)
    assert isinstance(task, PlateLiftTask)
    scene, settings = build_scene(task, cells), lift_settings(task.options)

    def tried(*, hope: bool, largest: int) -> list[PlateLiftPlanner]:
        planners: list[PlateLiftPlanner] = []

        class Seen(PlateLiftPlanner):
            def __init__(self, *args: Any) -> None:
                super().__init__(*args)
                planners.append(self)

            def may_keep(self, *_: Any, **__: Any) -> bool:
                return False

            def may_hold_as_stated(self) -> bool:
                return hope

        monkeypatch.setattr("planners.manipulation.lift_attempts.PlateLiftPlanner", Seen)
        plan = plan_lift(scene, replace(settings, largest_graph=largest), silent)
        assert plan.outcome is PlanningOutcome.NOT_FOUND
        return planners

    hopeful = tried(hope=True, largest=settings.largest_graph)
    assert len(hopeful) == 1 + len(settings.denser)
    sizes = [len(each.sampling.poses.poses) * len(each.sampling.grips) for each in hopeful]
    assert sizes == sorted(set(sizes))
    assert len(tried(hope=False, largest=settings.largest_graph)) < len(hopeful)
    # With room for half of the densest graph, it is a smaller one that is searched, not none.
    narrow = tried(hope=True, largest=hopeful[-1].reach.edge_count // 2)
    assert len(narrow) == len(hopeful)
    assert narrow[-1].fits
    assert narrow[-1].reach.edge_count <= hopeful[-1].reach.edge_count // 2
    # Its edges may be fewer than those of the one before, where what is proven leaves nodes out.
    (thinned,) = (len(each.sampling.poses.poses) * len(each.sampling.grips) for each in narrow[-1:])
    assert sizes[-2] < thinned < sizes[-1]


@pytest.mark.slow
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


def test_the_first_lift_is_found_with_its_cup_farther_out_as_well(cells: dict[str, Cell]) -> None:
    """By default, where it was not found once."""
    body = task_body("ab1", reserve=0.1)
    body["cup"]["position"] = [0.125, 0.0]
    assert planned(body, cells).outcome is PlanningOutcome.SOLVED
