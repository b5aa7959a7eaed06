"""Documents as the first version wrote them are still read, told and written as they were."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from app.summary import summarise
from app.viewer.page import describe_plan
from app.viewer.playback import Playback
from planners.cell.cell import load_cell
from tests.support.documents import plan_of
from tests.support.lift_documents import contact, lift, lift_document, segment, simulation

SCHEMAS = json.loads((Path(__file__).parents[1] / "contract_http/openapi-0.1.json").read_text())["components"][
    "schemas"
]
GRIP = {"arm": "right", "body": "plate", "pose": [0.0, -0.13, 0.0, 1.0, 0.0, 0.0, 0.0], "width": 0.04, "squeeze": 60.0}


def of_the_first_version(value: Any, schema: Mapping[str, Any]) -> Any:
    """Return JSON data without the members that the description of the first version does not know."""
    schema = _meant(value, schema)
    if isinstance(value, dict):
        known, others = schema.get("properties"), schema.get("additionalProperties")
        if known is not None:
            return {name: of_the_first_version(each, known[name]) for name, each in value.items() if name in known}
        if isinstance(others, dict):
            return {name: of_the_first_version(each, others) for name, each in value.items()}
    if isinstance(value, list) and "items" in schema:
        return [of_the_first_version(each, schema["items"]) for each in value]
    return round(value, 9) if isinstance(value, float) else value


def _meant(value: Any, schema: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return the schema of a value in place of one that refers to it, or offers it among others."""
    if "$ref" in schema:
        return _meant(value, SCHEMAS[schema["$ref"].rpartition("/")[2]])
    if "discriminator" in schema and isinstance(value, dict):
        by = schema["discriminator"]
        return _meant(value, {"$ref": by["mapping"][value[by["propertyName"]]]})
    for choice in schema.get("anyOf", ()):
        if value is not None and choice != {"type": "null"}:
            return _meant(value, choice)
    return schema


@pytest.fixture(scope="module")
def first() -> dict[str, Any]:
    """Return a simulated lift as the first version told it."""
    document = lift_document(load_cell("dual_ur3e_lift"))
    contacts = [
        contact(0, "right", "soft_finger", (0.0, 0.0, 3.0), finger=0, squeeze=60.0),
        contact(0, "cup", "suction", (0.0, 0.0, 6.0), suction_force=11.0),
    ]
    held = {"hold": {"grip": GRIP, "push": None}, "contacts": contacts, "reserve": [0.1] * 11}
    return of_the_first_version(
        {
            **document,
            "outcome": "solved",
            "segments": [segment(0.0, 11, kind="transfer", **held)],
            "simulation": simulation(3.0, lift=lift(1.5)),
        },
        SCHEMAS["PlanDocument"],
    )


def test_the_first_version_stated_less(first: dict[str, Any]) -> None:
    assert all("payload" not in arm for arm in first["cell"]["arms"].values())
    assert all("mass" not in hand for hand in first["cell"]["hands"].values())
    assert "kind" not in first["simulation"]
    assert "squeeze" not in first["segments"][0]["hold"]["grip"]
    assert "reserve" not in first["segments"][0]
    assert "mass_tolerance" not in first["task"]["plate"]


def test_a_first_document_is_played_and_told(first: dict[str, Any]) -> None:
    plan = plan_of(first)
    assert "Force reserve" not in [chart.title for chart in describe_plan(plan).sources["plan"].charts]
    assert "lifted, 200 mm" in summarise(plan)
    played = Playback(plan)
    assert played.durations == pytest.approx({"plan": 1.0, "simulation": 3.0})
    assert {force.by for force in played.at("simulation", 0.5).contacts} == {"right", "cup"}


def test_a_first_document_is_written_as_it_was_but_for_the_kind_of_its_simulation(first: dict[str, Any]) -> None:
    again = plan_of(first).document()
    assert again["simulation"].pop("kind") == "plate_lift"
    assert again == first


@pytest.mark.parametrize(
    ("needed", "available", "unit"), [(-0.0005, -0.0012, "m"), (0.0, -0.25, None), (4.0, 5.0, "N"), (5.0, None, "N")]
)
def test_a_cause_that_says_nothing_of_what_is_short_is_read(
    first: dict[str, Any], needed: float, available: float | None, unit: str | None
) -> None:
    cause = {"reason": "It falls.", "needed": needed, "available": available, "unit": unit}
    document = {**first, "outcome": "not_found", "explanation": {"summary": "None.", "causes": [cause]}}
    (read,) = plan_of({**document, "segments": [], "simulation": None}).explanation.causes
    assert (read.needed, read.available, read.unit) == (needed, available, unit)
