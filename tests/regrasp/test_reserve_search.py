"""A plan keeps the reserve that its task asks for, or the largest there can be, and says which."""

from __future__ import annotations

import pytest

from planners.cell.cell import load_cell
from planners.planning import HandoverSource
from planners.regrasp.grasps.handovers import HandoverSettings
from planners.scene.suction_tool import load_tool
from tests.support.tool_plans import Document, answered, block, few_handovers, planned

SPARE, TOOL = 3.0 - 1.205, 0.25
"""What the payload leaves beside a hand, and the long tool's mass [kg]."""


def reserves(document: Document) -> list[float]:
    return [left for segment in document["segments"] for left in segment["reserve"] if left is not None]


@pytest.fixture(scope="module")
def handovers() -> HandoverSource:
    """Those of the long tool, found once."""
    found = few_handovers(load_cell("dual_ur3e_tool"), load_tool("long_symmetric"), HandoverSettings())
    return lambda cell, tool, settings, progress: found


@pytest.fixture(scope="module")
def heavy(handovers: HandoverSource) -> Document:
    """Tool and block at rest leave a twentieth of the payload."""
    return planned({"objects": [block(mass=0.95 * SPARE - TOOL)], "options": {"reserve": 0.1}}, handovers=handovers)


def test_where_there_is_less_than_was_asked_for_the_plan_has_nearly_all_there_is(heavy: Document) -> None:
    """Three halvings between 0 and 0.1 leave at most an eighth of it unknown."""
    least = heavy["statistics"]["reserve"]
    assert 0.05 - 0.1 / 8 - 1e-6 <= least["value"] <= 0.05
    assert least["limited_by"] == "left hand's payload"


def test_the_summary_says_so(heavy: Document) -> None:
    summary = heavy["explanation"]["summary"]
    assert f"a reserve of {heavy['statistics']['reserve']['value']:.2g} instead of 0.1: left hand's payload" in summary


def test_the_smallest_reserve_is_the_least_of_all_samples(heavy: Document) -> None:
    least = heavy["statistics"]["reserve"]
    assert least["value"] == min(reserves(heavy))
    assert heavy["segments"][least["segment"]]["reserve"][least["sample"]] == least["value"]
    assert least["body"] == "tool"


@pytest.mark.parametrize("wanted", [0.0, 0.6])
def test_a_plan_keeps_the_reserve_it_is_asked_for_at_every_sample(wanted: float, handovers: HandoverSource) -> None:
    document = planned({"objects": [block()], "options": {"reserve": wanted}}, handovers=handovers)
    assert min(reserves(document)) >= wanted
    assert "reserve" not in document["explanation"]["summary"]


def test_reserves_are_told_where_a_hand_has_the_tool(heavy: Document) -> None:
    for segment in heavy["segments"]:
        held = segment["hold"] is not None and (
            segment["kind"] not in ("grip", "release") or segment["hold"]["second_grip"] is not None
        )
        assert [left is not None for left in segment["reserve"]] == [held] * len(segment["time"])


def test_that_there_is_no_plan_is_said_of_the_true_limits(handovers: HandoverSource) -> None:
    body = {"objects": [block(mass=1.01 * SPARE - TOOL)], "options": {"reserve": 0.5}}
    answer = answered(body, handovers=handovers)
    assert (answer["outcome"], answer["statistics"]["reserve"]) == ("infeasible", None)
    (cause,) = answer["explanation"]["causes"]
    assert (cause["needed"], cause["available"]) == pytest.approx((1.01 * SPARE * 9.81, SPARE * 9.81))
