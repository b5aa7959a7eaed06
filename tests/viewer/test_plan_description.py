"""What the page is told of a plan and its simulation."""

from __future__ import annotations

import json
from itertools import pairwise
from typing import Any

import pytest

from app.viewer.page import describe_plan
from tests.support.documents import plan_of
from tests.support.lift_documents import lift, segment, simulation


def described(document: dict[str, Any]) -> dict[str, Any]:
    return describe_plan(plan_of(document)).model_dump(mode="json", by_alias=True)


@pytest.fixture
def planned(document: dict[str, Any]) -> dict[str, Any]:
    """Return a plan of two seconds."""
    document["segments"] = [segment(0.0, 11), segment(1.0, 11, kind="transfer")]
    return document


def test_a_plan_without_a_simulation_is_all_that_can_be_played(planned: dict[str, Any]) -> None:
    told = described(planned)
    assert list(told["sources"]) == ["plan"]
    assert told["simulation"] is None


def test_the_lift_follows_the_segments_of_the_plan_without_gaps(planned: dict[str, Any]) -> None:
    planned["simulation"] = simulation(8.0, lift=lift(3.5))
    played = described(planned)["sources"]["simulation"]
    assert [stretch["kind"] for stretch in played["segments"]] == ["transit", "transfer", "settle", "lift"]
    assert all(a["end"] == pytest.approx(b["start"]) for a, b in pairwise(played["segments"]))
    assert played["segments"][-1]["end"] == played["duration"] == 8.0
    assert played["pages"] == [[0.0, 3.5], [3.5, 8.0]]


def test_a_simulation_that_fails_on_the_way_ends_where_something_gave_way(planned: dict[str, Any]) -> None:
    planned["simulation"] = simulation(1.4, outcome="slipped", cause="the tip slid off")
    told = described(planned)
    played = told["sources"]["simulation"]
    assert [(stretch["kind"], stretch["end"]) for stretch in played["segments"]] == [
        ("transit", 1.0),
        ("transfer", 1.4),
    ]
    assert told["simulation"]["good"] is False
    assert "1.40 s" in told["simulation"]["sentence"]
    assert "the tip slid off" in told["simulation"]["sentence"]


def test_a_failed_lift_is_told_with_its_time_in_the_lift_and_its_cause(planned: dict[str, Any]) -> None:
    planned["simulation"] = simulation(5.0, outcome="cup_lost", cause="the cup was over its 20 N", lift=lift(3.5))
    told = described(planned)["simulation"]
    assert told["words"] == "cup lost"
    assert "5.00 s, 1.50 s into the lift: the cup was over its 20 N" in told["sentence"]


def test_a_simulation_that_ended_before_its_first_sample_can_be_told(planned: dict[str, Any]) -> None:
    planned["simulation"] = simulation(0.0, outcome="slipped", cause="the tip slid off")
    json.dumps(described(planned), allow_nan=False)


def test_forces_at_the_nodes_are_compared_by_their_sizes(planned: dict[str, Any]) -> None:
    node = {
        "segment": 1,
        "time": 1.9,
        "planned": {"left": [3.0, 0.0, 4.0]},
        "simulated": {"left": [0.0, 6.0, 8.0]},
        "largest_difference": 7.8,
    }
    planned["simulation"] = simulation(8.0, lift=lift(3.5))
    planned["simulation"]["manipulation"]["nodes"] = [node]
    assert described(planned)["simulation"]["nodes"][0]["forces"] == [["left hand", "5.0", "10.0"]]


def test_the_time_that_planning_took_is_without_certificate_and_simulation(planned: dict[str, Any]) -> None:
    stages = {"scene": 0.25, "search": 1.5, "certify": 4.0, "simulate": 8.0}
    planned["statistics"] |= {
        "total_seconds": 13.75,
        "stages": [{"name": name, "seconds": seconds} for name, seconds in stages.items()],
    }
    assert ["planned in", "1.75 s"] in described(planned)["highlights"]


def test_a_cause_without_a_plan_tells_how_much_is_missing(document: dict[str, Any]) -> None:
    cause = {"reason": "No forces balance it.", "needed": 20.55, "available": 0.0, "unit": "N", "where": "face"}
    document |= {"outcome": "not_found", "explanation": {"summary": "None.", "causes": [cause]}}
    assert described(document)["causes"] == [{"reason": "No forces balance it", "numbers": "short by 20.55 N"}]


@pytest.mark.parametrize(
    ("kind", "kept", "told"),
    [
        ("cup_force", 0.05, "keeps back 5 % of 10 % asked for"),
        ("cup_force", 0.1, "keeps back 10 %"),
        # A change of what is asked for says so itself.
        ("reserve", 0.05, "keeps back 5 %"),
    ],
)
def test_a_remedy_that_keeps_less_back_than_is_asked_for_says_so(
    document: dict[str, Any], kind: str, kept: float, told: str
) -> None:
    remedy = {"kind": kind, "sentence": "Do so.", "patch": [], "outcome": "solved", "certified": True}
    explanation = {"summary": "None.", "remedies": [{**remedy, "reserve": kept, "largest_force": None}]}
    document |= {"outcome": "not_found", "explanation": explanation}
    document["task"]["options"]["reserve"] = 0.1
    (described_remedy,) = described(document)["remedies"]
    assert described_remedy["figures"] == f"solved, certified; {told}"


@pytest.mark.parametrize(("asked", "told"), [(0.1, "less than the 10 % asked for"), (0.04, ""), (None, "")])
def test_a_reserve_below_what_was_asked_for_says_so(planned: dict[str, Any], asked: float | None, told: str) -> None:
    where = {"limited_by": "cup: pull", "body": "plate", "segment": 1, "sample": 3}
    planned["statistics"]["reserve"] = {"value": 0.04, **where}
    planned["task"]["options"].pop("reserve", None)
    if asked is not None:
        planned["task"]["options"]["reserve"] = asked
    least = described(planned)["least_reserve"]
    assert least["asked"] == told
    assert least["time"] == pytest.approx(1.3)
    assert least["torque"] == ""


def test_beside_the_smallest_reserve_it_is_told_of_which_joints_torque_least_is_left(planned: dict[str, Any]) -> None:
    least = {"value": 0.2, "limited_by": "cup: pull", "body": "plate", "segment": 1, "sample": 3}
    planned["statistics"]["reserve"] = least
    check = {"name": "joint torque", "passed": True, "margin": 2.0, "unit": "Nm", "where": "left_elbow_joint"}
    planned["certificate"] = {"passed": True, "checks": [{**check, "share_left": 0.125}]}
    assert (
        described(planned)["least_reserve"]["torque"] == "Joint torque: 12.5 % of the limit remains, left elbow joint"
    )
