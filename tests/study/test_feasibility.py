"""What a kept graph says of a changed lift is what a graph made for that lift says."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from planners import read_task
from planners.contract.task_spec import PlateLiftTask
from planners.errors import SceneError
from planners.manipulation.planner import PlateLiftPlanner
from planners.plan.verdicts import Feasibility, PlanningOutcome
from planners.planning import lift_settings
from planners.progress import silent
from planners.scene.lift_scene import PlateLiftScene
from planners.scene.scene import build_scene
from planners.study.feasibility import FeasibilityExaminer

AB1 = json.loads((Path(__file__).parents[2] / "assets" / "tasks" / "ab1.json").read_text())
FEW = {"hold_density": 0.75, "simulate": False, "remedies": False}


def lift(**changes: Any) -> PlateLiftTask:
    task = {**AB1, "options": FEW}
    for pointer, value in changes.items():
        first, _, second = pointer.partition("__")
        task[first] = {**task[first], second: value} if second else value
    read = read_task(task)
    assert isinstance(read, PlateLiftTask)
    return read


def alone(task: PlateLiftTask) -> Feasibility | None:
    return FeasibilityExaminer().ask(task)


@pytest.fixture(scope="module")
def examiner() -> FeasibilityExaminer:
    examiner = FeasibilityExaminer()
    examiner.ask(lift())
    return examiner


FORCES = [
    {"cup__max_force": 12.0},
    {"cup__max_force": 19.0},
    {"cup__max_force": 80.0},
    {"cup__mu": 0.1},
    {"plate__mass": 4.5},
    {"plate__mass": 60.0},
    {"lifter_model": "cable"},
    {"hand_force_limit": {"normal": 4.0, "net": 5.0}},
    {"friction": {"grip": 0.3, "push": 0.2, "environment": 0.4}},
    {"options": {**FEW, "reserve": 0.4}},
    {"options": {**FEW, "reserve": 0.0}},
]


@pytest.mark.slow
def test_with_other_forces_it_is_as_if_the_graph_was_made_for_them(examiner: FeasibilityExaminer) -> None:
    found = []
    for changes in FORCES:
        kept, own = examiner.ask(lift(**changes)), alone(lift(**changes))
        assert kept is not None
        assert own is not None
        assert kept.kept == own.kept, changes
        assert kept.why is None or kept.kept is None
        found.append(kept.kept)
    assert None in found, "some forces leave no way"
    assert {0.0, 0.1} <= set(found), "some leave one with the reserve, some one without"


@pytest.mark.slow
def test_where_the_cup_is_moved_to_no_way_is_missed(examiner: FeasibilityExaminer) -> None:
    chance, ways = np.random.default_rng(3), set[bool]()
    for _ in range(4):
        task = lift(cup__position=chance.uniform((-0.12, -0.12), (0.12, 0.12)).tolist())
        kept, own = examiner.ask(task), alone(task)
        assert kept is not None
        assert own is not None
        # What the cup meets at its new place is left to whoever plans it: ways can only be too many.
        assert kept.kept is not None or own.kept is None
        ways.add(kept.kept is not None)
    assert ways == {True, False}


@pytest.mark.slow
def test_where_the_plate_is_moved_the_graph_is_made_anew(examiner: FeasibilityExaminer) -> None:
    far = lift(plate_pose=[0.5, 0.3, *AB1["plate_pose"][2:]])
    assert examiner.ask(far) == alone(far)
    assert examiner.ask(lift()) == alone(lift())


@pytest.mark.slow
def test_what_is_planned_has_a_way(examiner: FeasibilityExaminer) -> None:
    solved = []
    for place in ([0.1, 0.0], [0.12, 0.025]):
        task = lift(cup__position=place)
        found = examiner.ask(task)
        assert found is not None
        scene = build_scene(task)
        assert isinstance(scene, PlateLiftScene)
        plan = PlateLiftPlanner(scene, lift_settings(task.options), silent).plan(explained=False)
        solved.append(plan.outcome is PlanningOutcome.SOLVED)
        assert not solved[-1] or found.kept == task.options.reserve
    assert any(solved)


def test_of_what_is_no_lift_nothing_is_said_and_the_graph_stays(examiner: FeasibilityExaminer) -> None:
    before = examiner.ask(lift())
    with pytest.raises(SceneError):
        examiner.ask(lift(cup__position=[0.16, 0.0]))
    assert examiner.ask(lift()) == before
