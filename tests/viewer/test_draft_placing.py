"""A draft is read whatever is wrong with it, and what is moved in it comes to lie as the service asks for."""

from __future__ import annotations

import copy
import math
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from app.task_intake import accept_task
from app.viewer.editor.draft import PLATE, Draft, cell_of, read_draft
from app.viewer.editor.placing import put, written, yaw_of
from app.viewer.editor.starts import example_task
from planners.cell.cell import Cell, load_cells
from planners.errors import SceneError
from planners.geometry.pose import from_pose7, rotation_x, rotation_z, transform
from planners.scene.shape_source import ShapeSource
from planners.scene.suction_tool import SuctionTool, load_tools
from tests.support.service import TASKS, task

NONSENSE: tuple[Any, ...] = (None, "x", -1, [], {}, [None] * 7, [1e9] * 7, True)


@pytest.fixture(scope="module")
def cells() -> dict[str, Cell]:
    return load_cells()


@pytest.fixture(scope="module")
def tools() -> Mapping[str, SuctionTool]:
    return load_tools()


def draft_of(body: Any, cells: Mapping[str, Cell], tools: Mapping[str, SuctionTool]) -> tuple[Draft, Cell]:
    named = cell_of(body)
    kept = "dual_ur3e_tool" if isinstance(body, dict) and "objects" in body else "dual_ur3e_lift"
    cell = cells[named if named in cells else kept]
    return read_draft(body, cell, ShapeSource(), tools), cell


def members(value: Any, pointer: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Yield the paths of all members, the body itself first."""
    yield pointer
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, part in items:
        yield from members(part, (*pointer, key))


def with_member(body: Any, path: tuple[Any, ...], value: Any) -> Any:
    if not path:
        return value
    changed = copy.deepcopy(body)
    holder = changed
    for key in path[:-1]:
        holder = holder[key]
    holder[path[-1]] = value
    return changed


@pytest.mark.parametrize("name", ["ab3.json", "lid_under_roof.json"])
def test_whatever_is_wrong_with_a_task_the_rest_of_it_is_drawn(
    name: str, cells: Mapping[str, Cell], tools: Mapping[str, SuctionTool]
) -> None:
    body = task(name)
    whole, _ = draft_of(body, cells, tools)
    for path in members(body):
        pointer = "".join(f"/{step}" for step in path)
        for value in NONSENSE:
            draft, _ = draft_of(with_member(body, path, value), cells, tools)
            # A thing is lost only with a member that says what it is or where.
            lost = set(whole.parts) - set(draft.parts)
            assert all(set(pointer.split("/")[1:2]) & {*each.split("/"), "plate", "kind", "tool"} for each in lost) or (
                not path
            ), (pointer, value)


@pytest.mark.parametrize("name", sorted(path.name for path in TASKS.glob("*.json")))
def test_what_a_task_places_stays_where_it_is(
    name: str, cells: Mapping[str, Cell], tools: Mapping[str, SuctionTool]
) -> None:
    """Placed by those who wrote the task at whole millimetres and degrees, it is there already."""
    draft, cell = draft_of(task(name), cells, tools)
    assert draft.parts
    for part in draft.parts.values():
        if part.role != "tool":
            assert put(part, part.T_world_body, draft, cell) == pytest.approx(part.T_world_body, abs=2e-3)


def refusals(body: Any, cells: Mapping[str, Cell], tools: Mapping[str, SuctionTool]) -> str:
    try:
        accept_task(body, cells, tools=tools)
    except (SceneError, ValidationError) as error:
        return str(error)
    return ""


@pytest.mark.slow
def test_an_object_that_is_dropped_anywhere_rests_or_tips_but_never_hangs(
    cells: Mapping[str, Cell], tools: Mapping[str, SuctionTool]
) -> None:
    body = task("tissue_pile.json")
    draft, cell = draft_of(body, cells, tools)
    part, random = draft.parts["/objects/0/pose"], np.random.default_rng(4)
    accepted = 0
    for _ in range(60):
        x, y = random.uniform((0.1, -0.6), (0.7, 0.6))
        wanted = transform(rotation_z(random.uniform(-math.pi, math.pi)), [x, y, random.uniform(0.0, 2.0)])
        T = put(part, wanted, draft, cell)
        assert T[:2, 3] == pytest.approx([x, y], abs=0.5e-3 + 1e-9)
        assert np.allclose(1e3 * T[:2, 3], np.round(1e3 * T[:2, 3]), atol=1e-6)
        yaw = math.degrees(yaw_of(T[:3, :3]))
        assert yaw == pytest.approx(round(yaw), abs=1e-6)
        said = refusals(with_member(body, ("objects", 0, "pose"), written(T)), cells, tools)
        assert "rests on nothing" not in said
        assert "is tilted" not in said
        accepted += not said
    assert accepted > 20, "most of the table is free"


def test_what_is_moved_over_another_comes_to_lie_on_it(
    cells: Mapping[str, Cell], tools: Mapping[str, SuctionTool]
) -> None:
    draft, cell = draft_of(task("tissue_pile.json"), cells, tools)
    moved, below = draft.parts["/objects/0/pose"], draft.parts["/objects/1/pose"]
    T = put(moved, below.T_world_body, draft, cell)
    assert T[2, 3] - below.T_world_body[2, 3] == pytest.approx(0.06), "both are 60 mm high"


def test_a_goal_does_not_lie_on_what_is_there_at_the_start(
    cells: Mapping[str, Cell], tools: Mapping[str, SuctionTool]
) -> None:
    draft, cell = draft_of(task("tissue_pile.json"), cells, tools)
    goal, start = draft.parts["/objects/0/goal_pose"], draft.parts["/objects/1/pose"]
    assert put(goal, start.T_world_body, draft, cell)[2, 3] == pytest.approx(cell.table_top + 0.03)


def test_what_fits_under_a_roof_stays_under_it(cells: Mapping[str, Cell], tools: Mapping[str, SuctionTool]) -> None:
    body = task("lid_under_roof.json")
    draft, cell = draft_of(body, cells, tools)
    goal, roof = draft.parts["/objects/0/goal_pose"], draft.parts["/obstacles/0/pose"]
    assert put(goal, roof.T_world_body, draft, cell)[2, 3] == pytest.approx(cell.table_top + 0.01)
    low = with_member(body, ("obstacles", 0, "pose", 2), cell.table_top + 0.02)
    draft, _ = draft_of(low, cells, tools)
    above = put(draft.parts["/objects/0/goal_pose"], roof.T_world_body, draft, cell)
    assert above[2, 3] == pytest.approx(cell.table_top + 0.04), "with 10 mm of room a lid of 20 mm lies on top"


def test_what_lies_on_its_side_keeps_lying_on_it(cells: Mapping[str, Cell], tools: Mapping[str, SuctionTool]) -> None:
    draft, cell = draft_of(task("tissue_pile.json"), cells, tools)
    part = draft.parts["/objects/0/pose"]
    on_side = transform(rotation_x(0.5 * math.pi), [0.4, -0.1, 1.3])
    T = put(part, on_side, draft, cell)
    assert T[:3, :3] == pytest.approx(on_side[:3, :3], abs=1e-9)
    assert T[2, 3] == pytest.approx(cell.table_top + 0.5 * 0.115)


def test_an_obstacle_may_hang_and_a_plate_lies_on_its_support(
    cells: Mapping[str, Cell], tools: Mapping[str, SuctionTool]
) -> None:
    draft, cell = draft_of(task("lid_under_roof.json"), cells, tools)
    roof = draft.parts["/obstacles/0/pose"]
    assert put(roof, roof.T_world_body, draft, cell) == pytest.approx(roof.T_world_body)
    draft, cell = draft_of(task("ab3.json"), cells, tools)
    plate, support = draft.parts[PLATE], draft.parts["/support/pose"]
    T = put(plate, transform(None, [*support.T_world_body[:2, 3], 0.0]), draft, cell)
    assert T[2, 3] > support.T_world_body[2, 3] > cell.table_top


def test_a_pose_is_written_as_it_is_read() -> None:
    T = transform(rotation_z(math.radians(30.0)) @ rotation_x(0.5 * math.pi), [0.3, -0.125, 1.114])
    assert from_pose7(written(T)) == pytest.approx(T, abs=1e-8)


def test_every_example_is_one_to_begin_with() -> None:
    for path in TASKS.glob("*.json"):
        assert example_task(path.stem) == task(path.name)
