"""Whether a plan's path still holds with other forces: compared with what the plan itself says, and by what helps."""

from __future__ import annotations

from typing import Any

import pytest
import trimesh

from app.viewer.editor.feasibility import LastPath
from planners.cell.cell import Cell, load_cell
from planners.contract.task_spec import PlateLiftTask, read_task
from planners.geometry.solid_mesh import take_mesh
from planners.manipulation.statics.path_forces import PathFails, PathForces, PathHolds
from planners.manipulation.statics.reserves import STEPS
from planners.plan.plan import Plan
from planners.scene.scene import build_scene
from planners.scene.shape_source import no_uploads
from tests.support.plan_shelf import PlanShelf
from tests.support.service import task


@pytest.fixture(scope="module")
def cell() -> Cell:
    return load_cell("dual_ur3e_lift")


@pytest.fixture(scope="module")
def plan(shelf: PlanShelf) -> Plan:
    return shelf.plan(read_task(task("pb1.json")))


@pytest.fixture(scope="module")
def forces(plan: Plan) -> PathForces:
    return PathForces(plan)


def ask(forces: PathForces, cell: Cell, body: dict[str, Any]) -> PathHolds | PathFails:
    read = read_task(body)
    assert isinstance(read, PlateLiftTask)
    return forces.ask(build_scene(read, {cell.name: cell}))


def with_cup(**members: Any) -> dict[str, Any]:
    body = task("pb1.json")
    return {**body, "cup": {**body["cup"], **members}}


def test_of_its_own_task_a_path_keeps_what_the_plan_says(forces: PathForces, plan: Plan, cell: Cell) -> None:
    answer = ask(forces, cell, task("pb1.json"))
    assert isinstance(answer, PathHolds)
    assert plan.statistics.reserve is not None
    assert answer.reserve == pytest.approx(plan.statistics.reserve.value, abs=1.0 / STEPS)


def test_a_stronger_cup_never_keeps_less(forces: PathForces, cell: Cell) -> None:
    most = task("pb1.json")["cup"]["max_force"]
    kept = []
    for times in (0.2, 0.5, 0.8, 1.0, 1.3, 2.0):
        answer = ask(forces, cell, with_cup(max_force=times * most))
        kept.append(answer.reserve if isinstance(answer, PathHolds) else -1.0)
    assert kept == sorted(kept)
    assert kept[0] < 0.0 <= kept[-1], "a path that bears anything would be none"


def test_what_is_said_to_be_missing_is_what_helps(forces: PathForces, cell: Cell) -> None:
    most = task("pb1.json")["cup"]["max_force"]
    weak = 0.5 * most
    answer = ask(forces, cell, with_cup(max_force=weak))
    assert isinstance(answer, PathFails)
    assert answer.limit == "cup"
    assert isinstance(ask(forces, cell, with_cup(max_force=weak + answer.missing)), PathHolds)
    assert isinstance(ask(forces, cell, with_cup(max_force=weak + 0.9 * answer.missing)), PathFails)
    assert answer.missing <= most - weak + 0.02 * weak, "with the plan's own cup it holds"


def test_a_path_is_judged_where_forces_alone_have_changed(plan: Plan, cell: Cell) -> None:
    path, body = LastPath(plan, {cell.name: cell}, no_uploads), task("pb1.json")
    same = path.judge(body)
    assert same is not None
    assert same.holds
    heavier = path.judge({**body, "plate": {**body["plate"], "mass": 3.0 * body["plate"]["mass"]}})
    assert heavier is not None
    assert not heavier.holds
    moved = [body["plate_pose"][0] + 0.01, *body["plate_pose"][1:]]
    assert path.judge({**body, "plate_pose": moved}) is None
    assert path.judge({**body, "cup": {**body["cup"], "position": [9.0, 0.0]}}) is None
    assert path.judge(task("domino_pile.json")) is None
    assert path.judge("no task") is None


def test_a_path_is_judged_where_an_upload_stands_aside(plan: Plan, cell: Cell) -> None:
    cube = take_mesh(trimesh.creation.box((0.05, 0.05, 0.05)).export(file_type="stl"), "stl")
    aside = {"name": "aside", "shape": {"type": "mesh", "upload": "a" * 32}, "pose": [0.3, -0.8, 1.2, 1, 0, 0, 0]}
    body = {**task("pb1.json"), "obstacles": [aside]}
    path = LastPath(plan.model_copy(update={"task": read_task(body)}), {cell.name: cell}, {"a" * 32: cube}.get)
    judged = path.judge(body)
    assert judged is not None
    assert judged.holds
