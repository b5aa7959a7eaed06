"""Tasks that cannot stand as they say, and where the caller is pointed."""

import copy
import json
from pathlib import Path

import pytest
import yaml

from planners.cell.cell import load_cells
from planners.cell.needed_hands import FOR_LIFT, FOR_TOOL, check_shipped
from planners.contract.problems import problems_of
from planners.contract.task_spec import read_task
from planners.errors import SceneError
from planners.scene import placements
from planners.scene.scene import build_scene, cell_of

ROOT = Path(__file__).parents[2]
CASES = yaml.load((ROOT / "tests/problems/scene_refusals.yaml").read_text(), yaml.CSafeLoader)


@pytest.fixture(scope="module")
def cells():
    return load_cells()


def member(container, step):
    return int(step) if isinstance(container, list) else step


def body_of(case):
    body = json.loads((ROOT / f"assets/tasks/{case.get('task', 'ab1')}.json").read_text())
    for pointer, value in copy.deepcopy(case["with"]).items():
        if pointer == "/":
            return value
        *path, key = pointer.split("/")[1:]
        container = body
        for step in path:
            container = container[member(container, step)]
        container[member(container, key)] = value
    return body


def test_a_plate_over_the_edge_of_the_table_is_told_where_the_table_ends(cells):
    task = read_task(body_of({"with": {"/plate_pose/0": 0.8}}))
    with pytest.raises(SceneError, match="over the edge of the table") as caught:
        build_scene(task, cells)
    (table,) = (box for box in cells["dual_ur3e_lift"].boxes if box.name == "table")
    low, high = table.center - 0.5 * table.size, table.center + 0.5 * table.size
    ends = f"from x = {low[0]:.4g} to {high[0]:.4g} and from y = {low[1]:.4g} to {high[1]:.4g}"
    assert caught.value.detail.endswith(ends)


MEANT = {"dual_ur3e_lfit": "dual_ur3e_lift", "dual_ur5e_tol": "dual_ur5e_tool"}


@pytest.mark.parametrize("name", [*MEANT, *MEANT.values(), "moon_base"])
@pytest.mark.parametrize("task", ["ab1", "domino_pile"])
def test_the_files_alone_refuse_the_cells_that_whoever_loads_them_refuses(name, task, cells):
    """In the same words, with the same choices, and the one that is meant where a name is nearly right."""

    def told(check):
        try:
            check()
        except SceneError as error:
            return error.pointers, error.detail, error.allowed
        return None

    spec = read_task(body_of({"task": task, "with": {"/cell": name}}))
    refusal = told(lambda: check_shipped(name, FOR_LIFT if spec.kind == "plate_lift" else FOR_TOOL))
    assert refusal == told(lambda: cell_of(spec, cells))
    if name in MEANT:
        assert (MEANT[name] in refusal[2]) == refusal[1].endswith(f"did you mean {MEANT[name]}?")


def test_no_shipped_cell_is_loaded_to_say_which_ones_there_are(monkeypatch):
    """A service that has just begun would be waited for."""
    task = read_task(body_of({"with": {"/cell": "moon_base"}}))

    def load(name):
        pytest.fail(f"{name} was loaded")

    monkeypatch.setattr(placements, "load_cell", load)
    with pytest.raises(SceneError) as caught:
        cell_of(task)
    assert "dual_ur3e_lift" in caught.value.allowed


def test_a_cell_that_is_deleted_while_it_is_looked_for_is_one_that_there_is_not(cells):
    class Deleting(dict):
        def __contains__(self, name):
            return True

        def __iter__(self):
            yield from super().__iter__()
            yield "mars_base"

    task = read_task(body_of({"with": {"/cell": "moon_base"}}))
    with pytest.raises(SceneError, match="there is no cell moon_base") as caught:
        cell_of(task, Deleting(cells))
    assert "dual_ur3e_lift" in caught.value.allowed
    assert "mars_base" not in caught.value.allowed


@pytest.mark.parametrize("case", CASES, ids=[case["story"] for case in CASES])
def test_what_cannot_stand_is_pointed_at(case, cells):
    task = read_task(body_of(case))
    with pytest.raises(SceneError) as caught:
        build_scene(task, cells)
    problems = problems_of(caught.value)
    assert [problem.pointer for problem in problems] == case["pointers"]
    for problem in problems:
        assert case.get("says", "") in problem.detail
        assert problem.allowed == case.get("allowed")
