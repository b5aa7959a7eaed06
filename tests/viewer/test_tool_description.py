"""What the page is told of a suction-tool plan: words, curves, what was considered, and its simulation."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import viser

from app.viewer.drawing.body_drawing import Stage
from app.viewer.drawing.considered_signs import reason_colours
from app.viewer.drawing.link_meshes import LinkMeshes
from app.viewer.drawing.plan_scene import PlanScene
from app.viewer.page import describe_plan
from app.viewer.playback import Playback, objects_of_segments
from planners.cell.cell import Cell, load_cell
from tests.support.documents import plan_of
from tests.support.tool_documents import CUP, OBJECTS, OTHER, REACH, TOUCH, hold, tool_document, tool_simulation


@pytest.fixture(scope="module")
def tool_cell() -> Cell:
    return load_cell("dual_ur3e_tool")


@pytest.fixture
def planned(tool_cell: Cell) -> dict[str, Any]:
    return tool_document(tool_cell)


def described(document: dict[str, Any]) -> dict[str, Any]:
    told = describe_plan(plan_of(document)).model_dump(mode="json", by_alias=True)
    json.dumps(told, allow_nan=False)
    return told


def suction(sample: int, wrench: list[float]) -> dict[str, Any]:
    """Return the cup's contact on the first object, its axes along the world's."""
    return {
        "sample": sample, "body": "first", "by": "tool", "finger": None, "kind": "suction",
        "point": [0.4, 0.0, 1.114], "normal": [0.0, 0.0, -1.0], "x_axis": [1.0, 0.0, 0.0], "wrench": wrench,
        "mu": CUP["mu"], "radius": CUP["radius"], "kappa": CUP["kappa"], "limit": CUP["max_force"],
        "suction_force": wrench[2],
    }  # fmt: skip


def finger(sample: int, arm: str, number: int, force: float) -> dict[str, Any]:
    return {
        "sample": sample, "body": "tool", "by": arm, "finger": number, "kind": "soft_finger",
        "point": [0.4, 0.0, 1.2], "normal": [0.0, 1.0, 0.0], "wrench": [3.0, force, 0.0, 0.0, 0.0, 0.0],
        "mu": 0.5, "eps": 0.0075, "limit": 60.0,
    }  # fmt: skip


def test_the_timeline_is_grouped_by_the_object_that_is_moved(planned: dict[str, Any]) -> None:
    states = [segment["state"] for segment in described(planned)["sources"]["plan"]["segments"]]
    # The tool is taken for the first object, and comes off it before the second one's turn.
    assert states == ["first"] * 9 + ["second"] * 7


def test_an_object_that_is_let_go_is_the_subject_until_the_tool_is_off_it(planned: dict[str, Any]) -> None:
    subjects = objects_of_segments(plan_of(planned).segments)
    off = [i + 1 for i, segment in enumerate(planned["segments"]) if segment["kind"] == "detach"]
    assert [subjects[i] for i in off] == list(OBJECTS)


def test_the_card_says_who_does_what_with_which_object(planned: dict[str, Any]) -> None:
    words = [segment["words"] for segment in described(planned)["sources"]["plan"]["segments"]]
    assert words[2:9] == [
        "Right hand puts the cup on first",
        "Vacuum on: the cup takes first",
        "Right hand lifts first",
        "Right hand carries the tool with first",
        "Right hand puts first down",
        "Vacuum off: the cup lets first go",
        "Right hand takes the cup off first",
    ]


def test_the_card_says_in_which_hand_the_tool_is(planned: dict[str, Any]) -> None:
    planned["segments"][2]["hold"] = hold(planned["segments"][2]["hold"]["grip"], OTHER)
    holds = [segment["hold"] for segment in described(planned)["sources"]["plan"]["segments"]]
    assert holds[:3] == ["tool at rest", "tool in the right hand", "tool in both hands"]


@pytest.mark.parametrize(
    ("wrench", "used"),
    [
        ([0.0, 0.0, 5.0, 0.0, 0.0, 0.0], 25.0),
        ([0.0, 2.0, 0.0, 0.0, 0.0, 0.0], 100.0 * np.sqrt(3.0) * 2.0 / (0.5 * 20.0)),
        ([0.0, 0.0, 0.0, 0.03, 0.0, 0.0], 100.0 * np.sqrt(2.0) * 0.03 / (np.pi * 0.0175 * 4.5)),
        ([0.0, 0.0, 0.0, 0.0, 0.0, 0.02], 100.0 * np.sqrt(3.0) * 0.02 / (0.0175 * 0.5 * 20.0)),
    ],
)
def test_the_cup_is_used_by_the_contracts_cones(planned: dict[str, Any], wrench: list[float], used: float) -> None:
    planned["segments"][4]["contacts"] = [suction(0, wrench)]
    chart = described(planned)["sources"]["plan"]["charts"][0]
    assert chart["unit"] == "%"
    assert chart["series"][0]["values"] == pytest.approx([used], abs=1e-3)


def test_the_force_of_a_hand_is_that_of_its_harder_finger_and_has_a_gap_without_it(planned: dict[str, Any]) -> None:
    planned["segments"][4]["contacts"] = [finger(0, "right", 0, 7.0), finger(0, "right", 1, 9.0)]
    planned["segments"][5]["contacts"] = [suction(0, [0.0, 0.0, 1.0, 0.0, 0.0, 0.0])]
    chart = described(planned)["sources"]["plan"]["charts"][1]
    by_name = {line["name"]: line["values"] for line in chart["series"]}
    assert by_name["right"] == [9.0, None]
    assert by_name["left"] == [None, None]
    assert by_name["limit"] == [60.0, 60.0]


def test_what_was_considered_is_counted_by_reason_for_the_graph_that_moved_the_object(planned: dict[str, Any]) -> None:
    first, second = described(planned)["considered"]["objects"]
    assert first["places"] == [[None, 1], ["The pad would reach over.", 1]]
    assert first["grasps"] == [[None, 1], [REACH, 2], [TOUCH, 1]]
    assert first["graph"]["sequence"] == [0, 1, 2]
    assert second["graph"] is None


def test_every_reason_has_a_colour_of_its_own(planned: dict[str, Any]) -> None:
    considered = plan_of(planned).statistics.considered
    assert considered is not None
    colours = reason_colours(considered)
    assert {None, REACH, TOUCH, "The pad would reach over."} == set(colours)
    assert len(set(colours.values())) == len(colours)


def test_a_plan_of_nothing_considered_can_be_told(planned: dict[str, Any]) -> None:
    del planned["statistics"]["considered"]
    assert described(planned)["considered"] is None


def test_a_simulation_that_arrives_is_told_with_its_largest_error_and_a_stretch_after_the_plan(
    planned: dict[str, Any],
) -> None:
    planned["simulation"] = tool_simulation(2.0)
    told = described(planned)
    assert told["simulation"]["good"] is True
    assert "2.0 mm" in told["simulation"]["sentence"]
    last = told["sources"]["simulation"]["segments"][-1]
    assert (last["kind"], last["end"]) == ("still", 2.0)


def test_a_simulation_that_fails_is_told_with_time_and_cause(planned: dict[str, Any]) -> None:
    planned["simulation"] = tool_simulation(1.5, outcome="object_dropped", failed_at=0.7, cause="it came off the cup.")
    told = described(planned)["simulation"]
    assert (told["good"], told["words"]) == (False, "object dropped")
    assert told["sentence"] == "At 0.70 s: it came off the cup."


def test_bodies_are_between_the_samples_of_their_own_tracks(planned: dict[str, Any]) -> None:
    planned["simulation"] = tool_simulation(2.0)
    falls = {"time": [0.5, 1.0], "poses": [[0.4, 0.0, z, 1.0, 0.0, 0.0, 0.0] for z in (1.2, 1.1)]}
    planned["simulation"]["motion"]["bodies"]["first"] = falls
    played = Playback(plan_of(planned))
    heights = [played.at("simulation", time).body_poses["first"][2] for time in (0.1, 0.5, 0.75, 1.8)]
    assert heights == pytest.approx([1.2, 1.2, 1.15, 1.1])


def test_the_simulated_cup_pulls_on_what_hangs_on_it(planned: dict[str, Any]) -> None:
    planned["simulation"] = tool_simulation(2.0)
    curve = next(c for c in planned["simulation"]["force_curves"] if c["name"] == "suction load")
    curve["value"] = [1.5] * len(curve["time"])
    played = Playback(plan_of(planned))
    (pull,) = played.at("simulation", 0.55).contacts
    assert (pull.by, pull.body, pull.kind) == ("tool", "first", "suction")
    assert pull.force == pytest.approx([0.0, 0.0, 1.5])
    assert played.at("simulation", 0.05).contacts == ()


@pytest.fixture
def scene(planned: dict[str, Any], tool_cell: Cell, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    planned["simulation"] = tool_simulation(2.0)
    server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
    meshes = LinkMeshes(Path(tmp_path_factory.getbasetemp()) / "meshes")
    yield PlanScene(Stage(server.scene, "/stage", tool_cell, meshes), "/plan", Playback(plan_of(planned))), server.scene
    server.stop()


def test_what_was_considered_is_drawn_on_demand_for_the_object_of_the_moment(scene: Any) -> None:
    drawn, nodes = scene
    signs = ["/plan/bodies/first/places/pins", "/plan/grasps/first/possible", "/plan/grasps/first/rejected"]
    handles = [nodes.get_handle_by_name(name) for name in signs]
    assert [handle.visible for handle in handles] == [False] * 3
    for layer in ("places", "grasps"):
        drawn.set_layer(layer, True)
    assert [handle.visible for handle in handles] == [True] * 3
    drawn.show("plan", 1.4)
    assert [handle.visible for handle in handles] == [False] * 3
