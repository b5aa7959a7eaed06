"""What a study says of a point is what planning the task of that point says."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any, NoReturn

import pytest

from planners import read_task, solve
from planners.contract.task_spec import PlateLiftTask
from planners.manipulation.lift_attempts import plan_lift
from planners.manipulation.lift_plan import LiftPlan
from planners.plan.loads import largest_load
from planners.planning import TaskSolver, lift_settings
from planners.progress import silent
from planners.scene.lift_scene import PlateLiftScene
from planners.scene.scene import build_scene
from planners.study.examine import PointExaminer
from planners.study.study import Study
from planners.study.study_map import StudyMap, StudyPoint
from tests.support.samples import among
from workers.solver.pipeline import Pipeline

TASKS = Path(__file__).parents[2] / "assets" / "tasks"
AB1 = json.loads((TASKS / "ab1.json").read_text())
PLACES = [[0.1, 0.0], [-0.12, -0.04], [0.0, 0.0], [0.12, 0.12], [0.149, 0.0]]
"""Solved twice, not found twice, and with the cup over the edge."""


@pytest.fixture(scope="module")
def solver() -> TaskSolver:
    """Return a solver that no study may have simulate anything."""

    def simulate(*_: object) -> NoReturn:
        raise AssertionError("no point of a study tells of a simulation")

    return replace(Pipeline.load().solver, simulate=simulate)


def examined(study: Study, solver: TaskSolver) -> list[StudyPoint]:
    examiner = PointExaminer(solver)
    return [examiner.examine(study, index) for index in range(study.count)]


@pytest.fixture(scope="module")
def places(solver: TaskSolver) -> list[StudyPoint]:
    return examined(Study.read({"task": AB1, "axes": [{"pointer": "/cup/position", "values": PLACES}]}), solver)


def searched(task: dict[str, Any]) -> LiftPlan:
    """Search a lift as if nothing was known of any other."""
    read = read_task(task)
    assert isinstance(read, PlateLiftTask)
    scene = build_scene(read)
    assert isinstance(scene, PlateLiftScene)
    return plan_lift(scene, lift_settings(read.options), silent, persistent=False)


@pytest.mark.parametrize("index", among(range(4), [0]))
@pytest.mark.slow
def test_a_searched_point_is_the_task_changed_by_hand_and_searched(index: int, places: list[StudyPoint]) -> None:
    plan, point = searched(AB1 | {"cup": AB1["cup"] | {"position": PLACES[index]}}), places[index]
    kept = None if plan.reserve is None else plan.reserve.value
    assert (point.outcome, point.reserve, point.summary) == (plan.outcome.value, kept, plan.summary)
    assert (point.examined, point.certified) == ("searched", False)


def test_a_point_whose_task_there_cannot_be_is_refused_with_the_reason(places: list[StudyPoint]) -> None:
    assert (places[4].outcome, places[4].examined) == ("refused", None)
    assert places[4].summary.startswith("/cup/position: ")


@pytest.mark.slow
def test_a_planned_point_is_the_plan_of_its_task(solver: TaskSolver) -> None:
    forces = [12, 20]
    axis = {"pointer": "/cup/max_force", "values": forces}
    body = json.loads((TASKS / "ab2.json").read_text())
    points = examined(Study.read({"task": body, "axes": [axis], "certify": True}), solver)
    for force, point in zip(forces, points, strict=True):
        plan = solve(read_task(body | {"cup": body["cup"] | {"max_force": force}, "options": {"remedies": False}}))
        assert (point.outcome, point.summary) == (plan.outcome, plan.explanation.summary)
        assert point.certified == (plan.certificate is not None and plan.certificate.passed)
        if plan.outcome == "solved":
            assert plan.statistics.reserve is not None
            assert (point.reserve, point.largest_force) == (plan.statistics.reserve.value, largest_load(plan)[0])
    assert {point.examined for point in points} == {"planned"}


def test_objects_are_studied_too(solver: TaskSolver) -> None:
    lid = json.loads((TASKS / "lid_too_heavy.json").read_text())
    study = Study.read({"task": lid, "axes": [{"pointer": "/objects/0/pose/1", "values": [0.3, 0.35]}]})
    assert [point.outcome for point in examined(study, solver)] == ["infeasible", "infeasible"]


def test_the_best_point_is_solved_and_none_keeps_more_back(places: list[StudyPoint]) -> None:
    study = Study.read({"task": AB1, "axes": [{"pointer": "/cup/position", "values": PLACES}]})
    whole = StudyMap.of(study, places)
    assert whole.best is not None
    best = whole.points[whole.best.index]
    assert best.outcome == "solved"
    assert whole.best.values == [PLACES[best.index]]
    assert all((point.reserve or 0.0) <= (best.reserve or 0.0) + 1e-4 for point in places if point.outcome == "solved")
    assert sum(whole.outcomes.values()) == whole.done == whole.count
    # What is known in between is a map, too, in whatever order it came.
    assert StudyMap.of(study, places[:1:-1]).done == 3
    assert StudyMap.of(study, places[2:4]).best is None
