"""Where the cup sits when a task leaves that open: no other place keeps more back, and the plate's symmetries hold."""

from __future__ import annotations

import itertools
from functools import cache, partial
from typing import Any

import numpy as np
import pytest

from planners import read_task, solve
from planners.cell.cell import load_cells
from planners.contract.task_spec import PlateLiftTask
from planners.errors import SceneError
from planners.geometry import polygon
from planners.manipulation.cup_place import RESERVE_STEP, CupPlace, CupPlaceSearch
from planners.manipulation.planner import PlateLiftPlanner
from planners.plan.plan import Plan
from planners.planning import TaskSolver, lift_settings
from planners.progress import Report, silent
from planners.scene.lift_placements import cup_places, cup_step
from planners.scene.lift_scene import PlateLiftScene
from planners.scene.scene import build_scene
from tests.manipulation.lift_probe import task_body
from tests.support.plan_shelf import PlanShelf
from tests.support.service import task

AB1 = task_body("ab1")
ROUND = [[0.15 * np.cos(a), 0.15 * np.sin(a)] for a in np.linspace(0.0, 2.0 * np.pi, 12, endpoint=False)]
SHAPES = {
    "square": {"type": "box", "size": [0.3, 0.3, 0.04]},
    "long": {"type": "box", "size": [0.4, 0.2, 0.04]},
    "twelve corners": {"type": "prism", "outline": ROUND, "height": 0.04},
}


def open_task(**members: Any) -> PlateLiftTask:
    body = {**AB1, **members}
    cup = {name: value for name, value in body["cup"].items() if name != "position"}
    task = read_task({**body, "cup": cup})
    assert isinstance(task, PlateLiftTask)
    return task


@cache
def cells() -> Any:
    return load_cells()


def scene_of(task: PlateLiftTask) -> PlateLiftScene:
    return build_scene(task, cells())


@pytest.mark.parametrize("shape", SHAPES)
def test_places_are_all_over_the_plate_and_mirrored_as_the_plate_is(shape: str) -> None:
    plate = scene_of(open_task(plate={"shape": SHAPES[shape], "mass": 2.0})).plate
    radius = 0.0175
    step = cup_step(plate, radius)
    places = np.array(cup_places(plate, radius, step))
    assert (polygon.depth_inside(plate.outline, places) >= radius - 1e-6).all()
    for mirrored in (places * (-1.0, 1.0), places * (1.0, -1.0)):
        assert {*map(tuple, mirrored + 0.0)} == {*map(tuple, places)}
    inner = np.random.default_rng(1).uniform(plate.outline.min(axis=0), plate.outline.max(axis=0), (200, 2))
    inner = inner[polygon.depth_inside(plate.outline, inner) >= radius + step]
    assert (np.linalg.norm(inner[:, None] - places, axis=2).min(axis=1) <= step).all()
    off = np.linalg.norm(places - plate.com[:2], axis=1)
    assert (np.diff(off) >= -1e-5).all()


def test_a_scene_of_a_task_without_a_place_has_one() -> None:
    scene = scene_of(open_task())
    assert scene.cup.position.tolist() == [0.0, 0.0]


def test_the_cup_is_put_where_nothing_is_in_its_way() -> None:
    beam = {"name": "beam", "shape": {"type": "box", "size": [0.05, 0.05, 0.2]}, "pose": [0.3, 0, 1.25, 1, 0, 0, 0]}
    scene = scene_of(open_task(obstacles=[beam]))
    assert np.linalg.norm(scene.cup.position) > 0.025


@pytest.mark.parametrize(
    ("members", "pointer"),
    [
        ({"cup": {**AB1["cup"], "radius": 0.2}}, "/cup/radius"),
        ({"plate_pose": [0.3, 0, 1.5, 1, 0, 0, 0]}, "/plate_pose"),
    ],
)
def test_what_is_wrong_wherever_the_cup_sits_is_refused(members: dict[str, Any], pointer: str) -> None:
    with pytest.raises(SceneError) as refused:
        scene_of(open_task(**members))
    assert refused.value.pointer == pointer


# Which of the places is taken, with a planner that is told what to find.

BOUNDS = {(0.1, 0.0): 0.3, (0.0, 0.1): 0.2, (-0.1, 0.0): 0.05}


@pytest.fixture(scope="module")
def a_plan(shelf: PlanShelf) -> Plan:
    return shelf.plan(read_task(task("ab1.json")))


class Planning:
    """Finds plans that keep so much back, by the cup's place, or None."""

    def __init__(self, plan: Plan, kept: dict[tuple[float, float], float]) -> None:
        self.plan, self.kept, self.asked = plan, kept, list[tuple[float, float]]()

    def __call__(self, task: PlateLiftTask, *_: Any, **__: Any) -> Plan:
        self.asked.append(task.cup.place)
        reserve, statistics = self.kept.get(task.cup.place), self.plan.statistics
        assert statistics.reserve is not None
        if reserve is None:
            return self.plan.model_copy(update={"task": task, "outcome": "not_found", "segments": []})
        least = statistics.reserve.model_copy(update={"value": reserve})
        return self.plan.model_copy(
            update={"task": task, "statistics": statistics.model_copy(update={"reserve": least})}
        )


@pytest.mark.parametrize(
    ("wanted", "kept", "asked", "taken"),
    [
        ("risk", {(0.1, 0.0): 0.3, (0.0, 0.1): 0.2}, 1, (0.1, 0.0)),
        ("risk", {(0.1, 0.0): 0.1, (0.0, 0.1): 0.2}, 2, (0.0, 0.1)),
        ("risk", {(0.0, 0.1): 0.2}, 2, (0.0, 0.1)),
        ("risk", {(-0.1, 0.0): 0.05}, 3, (-0.1, 0.0)),
        ("cost", {(0.1, 0.0): 0.1, (0.0, 0.1): 0.2}, 1, (0.1, 0.0)),
        ("cost", {(0.1, 0.0): 0.02, (0.0, 0.1): 0.1}, 2, (0.0, 0.1)),
        ("cost", {}, 4, (0.1, 0.0)),
    ],
)
def test_the_plan_is_taken_that_keeps_most(
    a_plan: Plan,
    monkeypatch: pytest.MonkeyPatch,
    wanted: str,
    kept: dict[tuple[float, float], float],
    asked: int,
    taken: tuple[float, float],
) -> None:
    """A place is planned only as long as the forces there promise more than is found; at last the best, at length."""
    places = [CupPlace(True, bound, 0.0, -0.1, place) for place, bound in BOUNDS.items()]
    monkeypatch.setattr(CupPlaceSearch, "candidates", lambda *_: places)
    planning = Planning(a_plan, kept)
    solver = TaskSolver(cells(), {}, plan=planning, certify=lambda *_: None)
    found = solver.solve(open_task(options={"minimise": wanted, "remedies": False}))
    assert len(planning.asked) == asked
    told = found.explanation.cup_place
    assert told is not None
    assert isinstance(found.task, PlateLiftTask)
    assert found.task.cup.position == told.position == taken
    assert found.outcome == ("solved" if kept else "not_found")
    assert told.sentence in found.explanation.summary


def test_what_is_infeasible_is_so_wherever_the_cup_sits() -> None:
    weak = task_body("pb1_weak_cup")
    told: list[Report] = []
    plan = solve(open_task(**{**weak, "options": {"remedies": False}}), on_progress=told.append)
    assert (plan.outcome, plan.certificate and plan.certificate.passed) == ("infeasible", True)
    assert plan.explanation.cup_place is not None
    assert plan.explanation.cup_place.tried == 0
    assert "wherever the cup sits" in plan.explanation.summary
    assert "cup places" not in {report.stage for report in told}


# With the planner itself.

FAST = {"remedies": False, "contact_density": 0.5, "hold_density": 0.5}


@pytest.mark.slow
def test_no_other_place_keeps_more_back() -> None:
    """Asked of a grid of the test's own; the plan of the stated place is the plan that is found."""
    task = open_task(options={**FAST, "minimise": "risk"})
    plan = solve(task)
    assert plan.outcome == "solved"
    assert isinstance(plan.task, PlateLiftTask)
    assert plan.statistics.reserve is not None
    settings = lift_settings(task.options)
    for place in itertools.product(np.linspace(-0.12, 0.12, 5).tolist(), repeat=2):
        planner = PlateLiftPlanner(scene_of(task.with_cup_at(place)), settings, silent)
        assert not planner.may_keep(plan.statistics.reserve.value + 4.0 * RESERVE_STEP, low=False), place
    again, found = solve(plan.task).document(), plan.document()
    assert again["segments"] == found["segments"]
    assert again["statistics"]["reserve"] == found["statistics"]["reserve"]


@pytest.mark.slow
def test_a_plate_turned_by_half_has_the_cup_on_the_other_side() -> None:
    """The square plate looks the same: what is kept back is, up to how densely its rim is sampled."""
    tasks = [open_task(options=FAST, plate_pose=[0.3, 0, 1.114, *q]) for q in ((1, 0, 0, 0), (0, 0, 0, 1))]
    best = [
        CupPlaceSearch(task, partial(build_scene, cells=cells()), lift_settings(task.options), silent).candidates(
            scene_of(task)
        )[0]
        for task in tasks
    ]
    assert best[1].kept == pytest.approx(best[0].kept, abs=2.0 * RESERVE_STEP)
    mirrored = tasks[1].with_cup_at((-best[0].position[0], -best[0].position[1]))
    planner = PlateLiftPlanner(scene_of(mirrored), lift_settings(mirrored.options), silent)
    assert planner.may_keep(best[0].kept - 2.0 * RESERVE_STEP, low=False)
