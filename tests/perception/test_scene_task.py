"""Tasks that are filled in from perceived scenes, and the scenes that are shipped."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from planners.cell.asset_shelf import shipped_tool
from planners.cell.cell import Cell, load_cell
from planners.cell.cell_tool import CellTool, CellToolPart
from planners.contract.scan_spec import read_scan
from planners.contract.scene_document import SceneDocument
from planners.contract.task_spec import SuctionToolTask, ToolPart, read_task
from planners.errors import SceneError
from planners.geometry.pose import from_pose7
from planners.perception.perceive import PerceivedScene, perceive
from planners.perception.scene_task import fill_from_scene, stand_up
from planners.scene.scene import build_scene
from tests.support.scan_frames import PILES, SHIPPED, shipped

GOAL = [0.38, 0.0, 1.124, 1.0, 0.0, 0.0, 0.0]


@pytest.fixture(scope="module")
def cell() -> Cell:
    return load_cell("dual_ur3e_tool")


@pytest.fixture(scope="module")
def perceived(cell: Cell) -> PerceivedScene:
    scan = shipped()
    return perceive(read_scan(scan.description), scan.files, cell)


@pytest.fixture(scope="module")
def scene(perceived: PerceivedScene) -> SceneDocument:
    return perceived.document


def task(*detections: str, **members: Any) -> dict[str, Any]:
    objects = [{"detection": name, "mass": 0.3, "goal_pose": GOAL} for name in detections]
    return {"kind": "suction_tool", "scene_id": "seen", "objects": objects, **members}


@pytest.mark.parametrize("name", PILES)
def test_every_shipped_scan_shows_its_objects_and_its_task_fits_it(name: str, cell: Cell) -> None:
    kind, size, places = PILES[name]
    scan = shipped(name)
    seen = perceive(read_scan(scan.description), scan.files, cell).document
    assert len(seen.objects) == len(places)
    for each in seen.objects:
        assert each.shape.type == kind
        extents = each.shape.size if each.shape.type == "box" else (*2 * [2 * each.shape.radius], each.shape.height)
        np.testing.assert_allclose(extents, size, atol=0.005)
    body = json.loads((SHIPPED / name / "task.json").read_text())
    build_scene(read_task(fill_from_scene({**body, "scene_id": "seen"}, seen, cell)))


def changed(scene: SceneDocument, **members: Any) -> SceneDocument:
    return SceneDocument.model_validate({**scene.model_dump(), **members})


def test_the_shipped_scan_shows_three_tissue_boxes_and_the_tool_in_its_rest(scene: SceneDocument, cell: Cell) -> None:
    assert [each.name for each in scene.objects] == ["object_1", "object_2", "object_3"]
    for each in scene.objects:
        assert each.shape.type == "box"
        np.testing.assert_allclose(each.shape.size, (0.24, 0.115, 0.06), atol=0.004)
    assert scene.tool is not None
    assert cell.tool_rest is not None
    assert np.linalg.norm(np.subtract(scene.tool.markers_at[:2], cell.tool_rest.T_world_tool[:2, 3])) < 0.004
    assert scene.unrecognised == ()


def with_tool(cell: Cell, name: str, **members: Any) -> Cell:
    """Return the cell with a tool of its own that is the long one by another name."""
    file = shipped_tool("long_symmetric").model_copy(update={"name": name, **members})
    parts = [CellToolPart(part.shape, np.array(part.pose)) for part in file.tool.shapes if isinstance(part, ToolPart)]
    return replace(cell, tools={name: CellTool(file, tuple(parts))})


def test_a_tool_that_a_cell_brings_is_found_by_the_markers_that_its_file_states(
    perceived: PerceivedScene, cell: Cell
) -> None:
    scan, own = shipped(), with_tool(cell, "handle")
    found = perceive(read_scan({**scan.description, "tool": "handle"}), scan.files, own).document
    assert found.tool is not None
    assert perceived.document.tool is not None
    assert found.tool == perceived.document.tool.model_copy(update={"name": "handle"})
    assert found.objects == perceived.document.objects
    body = {**task(found.objects[0].name), "cell": "dual_ur3e_tool"}
    assert fill_from_scene(body, found, own)["tool"] == "handle"


def test_a_tool_without_markers_and_one_that_the_cell_does_not_have_are_pointed_at(cell: Cell) -> None:
    scan, own = shipped(), with_tool(cell, "handle", markers=None)
    with pytest.raises(SceneError, match="no markers are stated in the file of the tool handle") as caught:
        perceive(read_scan({**scan.description, "tool": "handle"}), scan.files, own)
    assert caught.value.pointer == "/markers"
    with pytest.raises(SceneError, match="there is no tool hook") as caught:
        perceive(read_scan({**scan.description, "tool": "hook"}), scan.files, own)
    assert caught.value.pointer == "/tool"
    assert caught.value.allowed is not None
    assert {"handle", "long_symmetric"} <= set(caught.value.allowed)


def test_the_same_scan_gives_the_same_scene(perceived: PerceivedScene, cell: Cell) -> None:
    scan = shipped()
    again = perceive(read_scan(scan.description), scan.files, cell)
    assert again.document == perceived.document
    assert again.preview == perceived.preview


def test_a_filled_task_can_be_begun_and_filling_it_again_changes_nothing(scene: SceneDocument, cell: Cell) -> None:
    body = json.loads((SHIPPED / "tissue_boxes" / "task.json").read_text()) | {"scene_id": "seen"}
    filled = fill_from_scene(body, scene, cell)
    accepted = read_task(filled)
    assert isinstance(accepted, SuctionToolTask)
    assert accepted.obstacles == ()
    build_scene(accepted, {cell.name: cell})
    assert fill_from_scene(filled, scene, cell)["objects"] == filled["objects"]


def test_sides_have_their_uncertainty_as_clearance_and_heights_have_none(scene: SceneDocument, cell: Cell) -> None:
    filled = fill_from_scene(task("object_1"), scene, cell)["objects"][0]
    seen = scene.objects[0]
    assert seen.shape.type == "box"
    np.testing.assert_array_less(seen.shape.size[:2], filled["shape"]["size"][:2])
    # A side may be off by what its place and half of its length are off, each twice what is told, at either end.
    wanted = 2.0 * 2.0 * math.hypot(max(seen.uncertainty.position[:2]), 0.5 * max(seen.uncertainty.size[:2]))
    np.testing.assert_allclose(np.subtract(filled["shape"]["size"][:2], seen.shape.size[:2]), wanted)
    assert filled["shape"]["size"][2] == seen.shape.size[2]


def test_neighbours_get_no_more_clearance_than_there_is_room(scene: SceneDocument, cell: Cell) -> None:
    one = scene.objects[0]
    assert one.shape.type == "box"
    width = one.shape.size[1]
    side = from_pose7(one.pose)[:3, 1]
    for gap in (0.0015, 0.0002, -0.001):
        pose = (*(np.array(one.pose[:3]) + (width + gap) * side).tolist(), *one.pose[3:])
        other = one.model_copy(update={"name": "object_2", "pose": pose})
        crowded = changed(scene, objects=[one.model_dump(), other.model_dump()])
        body = task("object_1", "object_2")
        body["objects"][1]["goal_pose"] = [0.6, -0.3, *GOAL[2:]]
        build_scene(read_task(fill_from_scene(body, crowded, cell)), {cell.name: cell})


def test_goals_are_put_down_on_what_is_below_them(scene: SceneDocument, cell: Cell) -> None:
    body = task("object_1", "object_2", "object_3")
    for i, given in enumerate(body["objects"]):
        given["goal_pose"] = [0.38, 0.0, 1.124 + 0.063 * i, *GOAL[3:]]
    filled = fill_from_scene(body, scene, cell)["objects"]
    top = cell.table_top
    for given in filled:
        height = given["shape"]["size"][2]
        assert given["goal_pose"][2] == pytest.approx(top + 0.5 * height)
        top += height


def test_what_a_task_says_itself_stays(scene: SceneDocument, cell: Cell) -> None:
    pose = [0.3, 0.0, 1.124, 1.0, 0.0, 0.0, 0.0]
    body = task("object_1", tool_pose=[0.25, 0.0, cell.table_top, 1.0, 0.0, 0.0, 0.0])
    body["objects"][0] |= {"name": "mine", "pose": pose}
    filled = fill_from_scene(body, scene, cell)
    assert filled["objects"][0]["pose"] == pose
    assert filled["objects"][0]["name"] == "mine"
    assert filled["tool_pose"] == body["tool_pose"]


def test_what_the_task_does_not_name_is_in_the_way(scene: SceneDocument, cell: Cell) -> None:
    outline = [[0.6, -0.1], [0.7, -0.1], [0.7, 0.0], [0.6, 0.0]]
    cluttered = changed(scene, unrecognised=[{"reason": "it has no level top", "outline": outline, "top": 1.2}])
    filled = fill_from_scene(task("object_1"), cluttered, cell)
    accepted = read_task(filled)
    assert [each.name for each in accepted.obstacles] == ["object_2", "object_3", "unrecognised_1"]
    build_scene(accepted, {cell.name: cell})
    kept = np.array(filled["obstacles"][2]["shape"]["outline"]) + filled["obstacles"][2]["pose"][:2]
    assert np.all(kept.min(axis=0) <= np.min(outline, axis=0))
    assert np.all(kept.max(axis=0) >= np.max(outline, axis=0))


def test_what_was_seen_and_is_not_named_takes_no_name_that_the_task_uses(scene: SceneDocument, cell: Cell) -> None:
    outline = [[0.6, -0.1], [0.7, -0.1], [0.7, 0.0], [0.6, 0.0]]
    cluttered = changed(scene, unrecognised=[{"reason": "it has no level top", "outline": outline, "top": 1.2}])
    own = {"name": "unrecognised_1", "shape": {"type": "box", "size": [0.05, 0.05, 0.05]}}
    body = task("object_1", obstacles=[{**own, "pose": [0.2, 0.6, 1.119, 1, 0, 0, 0]}])
    body["objects"][0]["name"] = "object_2"
    accepted = read_task(fill_from_scene(body, cluttered, cell))
    names = [each.name for each in (*accepted.objects, *accepted.obstacles)]
    assert names[:2] == ["object_2", "unrecognised_1"]
    assert len(set(names)) == len(names) == 5


def test_the_tool_stands_up_with_its_markers_where_they_were_seen(scene: SceneDocument, cell: Cell) -> None:
    filled = fill_from_scene(task("object_1"), scene, cell)
    T = from_pose7(filled["tool_pose"])
    assert scene.tool is not None
    np.testing.assert_allclose(T[:3, 2], [0.0, 0.0, 1.0], atol=1e-9)
    assert T[2, 3] == pytest.approx(cell.table_top)
    np.testing.assert_allclose((T @ [0.0, 0.0, 0.25, 1.0])[:2], scene.tool.markers_at[:2], atol=1e-6)


def test_a_table_that_was_seen_elsewhere_is_refused(scene: SceneDocument, cell: Cell) -> None:
    assert scene.table is not None
    moved = changed(scene, table={**scene.table.model_dump(), "height": scene.table.height + 0.02})
    with pytest.raises(SceneError, match="mm off its height"):
        fill_from_scene(task("object_1"), moved, cell)


@pytest.mark.parametrize("carriers", [["ghost"], ["a"], ["b", "a"], ["b", "c", "b"]])
def test_a_scene_whose_objects_stand_on_nothing_there_is_is_refused(scene: SceneDocument, carriers: list[str]) -> None:
    one = scene.model_dump(mode="json")["objects"][0]
    objects = [{**one, "name": name, "supported_by": each} for name, each in zip("abc", carriers, strict=False)]
    with pytest.raises(ValidationError, match="neither on the table nor on an object"):
        SceneDocument.model_validate_json(json.dumps({**scene.model_dump(mode="json"), "objects": objects}))


def test_objects_are_stood_up_from_the_table_whatever_their_heights(scene: SceneDocument, cell: Cell) -> None:
    """A low and wide object is seen before the one below it, or the depth is off: order is by what carries what."""
    one = scene.model_dump(mode="json")["objects"][0]
    x, y, z, *turn = one["pose"]
    objects = [
        {**one, "name": "upper", "supported_by": "lower", "pose": [x, y, z, *turn]},
        {**one, "name": "lower", "supported_by": "table", "pose": [x, y, z + 0.5, *turn]},
    ]
    document = SceneDocument.model_validate_json(json.dumps({**scene.model_dump(mode="json"), "objects": objects}))
    upper, lower = stand_up(document, cell)
    assert upper.top > lower.top > cell.table_top
