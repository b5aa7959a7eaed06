"""The regrasp graphs of a document tell the plan that is moved."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import pytest

from planners.geometry.pose import from_pose7
from planners.plan.considered import Considered
from planners.plan.plan import Plan
from tests.support.tool_plans import QUARTER, block, planned

ACROSS = {"pose": [0.3, 0.42, 1.104, *QUARTER], "goal_pose": [0.3, -0.4, 1.104, *QUARTER]}


@pytest.fixture(scope="module")
def document() -> dict[str, Any]:
    """A block that goes from one arm's side to the other's."""
    return planned({"objects": [block(**ACROSS)]})


@pytest.fixture(scope="module")
def considered(document: dict[str, Any]) -> dict[str, Any]:
    return document["statistics"]["considered"]


@pytest.fixture(scope="module")
def graph(considered: dict[str, Any]) -> dict[str, Any]:
    (graph,) = (one for one in considered["regrasp_graphs"] if one["moved"])
    return graph


def arm_and_grasp(graph: dict[str, Any], considered: dict[str, Any], node: int) -> tuple[str, int]:
    arm, grasp = divmod(node, len(considered["tool_grasps"]["poses"]))
    return graph["arms"][arm], grasp


def test_what_was_considered_is_as_the_contract_says(document: dict[str, Any]) -> None:
    assert Plan.model_validate(document).document() == document
    Considered.model_validate(document["statistics"]["considered"])


def test_the_chosen_edges_lead_from_one_to_the_next_and_end_at_a_goal(graph: dict[str, Any]) -> None:
    edges = [graph["edges"][number] for number in graph["sequence"]]
    assert {edge["state"] for edge in edges} == {"chosen"}
    assert edges[0]["from"] is None
    assert all(following["from"] == edge["to"] for edge, following in pairwise(edges))
    assert [edge["round"] for edge in edges] == sorted(edge["round"] for edge in edges)
    assert (edges[-1]["kind"], edges[-1]["round"]) == ("transfer", 1)
    assert edges[-1]["goal"] in {layer["goal"] for layer in graph["layers"] if layer["layer"] == "goal"}
    others = [edge for number, edge in enumerate(graph["edges"]) if number not in graph["sequence"]]
    assert "chosen" not in {edge["state"] for edge in others}


def test_a_handover_changes_the_arm_and_a_transfer_the_place(graph: dict[str, Any], considered: dict[str, Any]) -> None:
    assert "handover" in {edge["kind"] for edge in graph["edges"]}
    for edge in graph["edges"]:
        if edge["kind"] == "transfer":
            assert edge["from"] == edge["to"]
        elif edge["kind"] == "handover":
            giver, receiver = (arm_and_grasp(graph, considered, edge[end])[0] for end in ("from", "to"))
            assert giver != receiver


def test_nodes_of_the_sequence_are_possible_in_their_layers(graph: dict[str, Any]) -> None:
    layers = {(layer["layer"], layer["goal"]): layer for layer in graph["layers"]}
    for edge in (graph["edges"][number] for number in graph["sequence"]):
        if edge["kind"] == "pick":
            assert edge["to"] in layers["initial", None]["possible"]
        elif edge["kind"] == "transfer":
            layer = layers["suction", None] if edge["round"] == 0 else layers["goal", edge["goal"]]
            assert edge["to"] in layer["possible"]
    for layer in graph["layers"]:
        rejected = [node for nodes in layer["rejected"].values() for node in nodes]
        assert not set(rejected) & set(layer["possible"])


def test_the_grips_of_the_motion_are_the_grasps_of_the_sequence(
    document: dict[str, Any], graph: dict[str, Any], considered: dict[str, Any]
) -> None:
    taken = [
        arm_and_grasp(graph, considered, graph["edges"][number]["to"])
        for number in graph["sequence"]
        if graph["edges"][number]["kind"] in ("pick", "handover")
    ]
    grips = [segment["hold"]["grip"] for segment in document["segments"] if segment["kind"] == "grip"]
    assert [arm for arm, _ in taken] == [grip["arm"] for grip in grips]
    for (_, grasp), grip in zip(taken, grips, strict=True):
        pose = considered["tool_grasps"]["poses"][grasp]
        assert from_pose7(pose) == pytest.approx(from_pose7(grip["pose"]), abs=1e-6)
        assert grip["width"] == pytest.approx(considered["tool_grasps"]["widths"][grasp], abs=1e-6)


def test_the_suction_layer_has_the_tool_on_the_object(document: dict[str, Any], graph: dict[str, Any]) -> None:
    (layer,) = (layer for layer in graph["layers"] if layer["layer"] == "suction")
    T_world_block = from_pose7(document["bodies"]["block"]["pose"])
    assert from_pose7(layer["tool_pose"]) == pytest.approx(T_world_block @ from_pose7(graph["suction_pose"]), abs=1e-6)
