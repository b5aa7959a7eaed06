"""Whatever schema 1.0 allows to be null or to be left out can be told and drawn."""

from __future__ import annotations

import copy
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import viser
from pydantic import ValidationError

from app.summary import summarise
from app.viewer.drawing.body_drawing import Stage
from app.viewer.drawing.link_meshes import LinkMeshes
from app.viewer.drawing.plan_scene import PlanScene
from app.viewer.page import describe_plan
from app.viewer.playback import Playback
from planners.cell.cell import Cell, load_cell
from planners.plan.plan import plan_schema
from tests.support.documents import plan_of
from tests.support.lift_documents import contact, lift, segment, simulation
from tests.support.samples import among
from tests.support.tool_documents import GRIP, OTHER, hold, tool_document, tool_simulation

SCHEMA = plan_schema()
NULL = {"type": "null"}
NEEDED_BY_OTHERS = {"finger", "with", "grip"}
"""Members that may be null, but not of a soft finger, where a body touches something, or beside a second grip."""
Spot = tuple[str | int, ...]
"""A place in a document, by members and indices."""


def spots(schema: Mapping[str, Any], value: Any, path: Spot = ()) -> Iterator[tuple[Spot, bool]]:
    """Yield every place of a document that the schema lets be null (False) or be left out (True)."""
    schema = _meant(schema, value)
    choices = schema.get("anyOf", [schema])
    if NULL in choices or _is_any_json(schema):
        yield path, False
    if value is None:
        return
    for choice in choices:
        meant = _meant(choice, value)
        if isinstance(value, dict):
            yield from _members(meant, value, path)
        elif isinstance(value, list) and _is_list_of_things(meant):
            for index, each in enumerate(value):
                yield from spots(meant["items"], each, (*path, index))


def _meant(schema: Mapping[str, Any], value: Any) -> Mapping[str, Any]:
    """Return the schema of a value in place of one that refers to it, or offers it among others."""
    if "discriminator" in schema and value is not None:
        by = schema["discriminator"]
        return _meant({"$ref": by["mapping"][value[by["propertyName"]]]}, value)
    if "$ref" in schema:
        return _meant(SCHEMA["$defs"][schema["$ref"].rpartition("/")[2]], value)
    return schema


def _is_list_of_things(schema: Mapping[str, Any]) -> bool:
    """Tell whether a list is of more than numbers, of which none may be null."""
    return "items" in schema and _meant(schema["items"], None).get("type") not in ("number", "integer", "array")


def _is_any_json(schema: Mapping[str, Any]) -> bool:
    return not schema.keys() - {"default", "title", "description"}


def _members(schema: Mapping[str, Any], value: Mapping[str, Any], path: Spot) -> Iterator[tuple[Spot, bool]]:
    known, required = schema.get("properties", {}), schema.get("required", ())
    others = {} if _is_any_json(schema) else schema.get("additionalProperties")
    for name, each in value.items():
        inner = known.get(name, others)
        if not isinstance(inner, Mapping):
            continue
        # A task in a document has every default filled in.
        if name in known and name not in required and "task" not in path:
            yield (*path, name), True
        yield from spots(inner, each, (*path, name))


def changed(document: Mapping[str, Any], spot: Spot, *, left_out: bool) -> dict[str, Any]:
    """Return a document with null at a place, or with nothing there."""
    other = copy.deepcopy(dict(document))
    place: Any = other
    for key in spot[:-1]:
        place = place[key]
    if left_out:
        del place[spot[-1]]
    else:
        place[spot[-1]] = None
    return other


def described(document: Mapping[str, Any]) -> dict[str, Any]:
    return describe_plan(plan_of(document)).model_dump(mode="json", by_alias=True)


@pytest.fixture
def lifted(document: dict[str, Any]) -> dict[str, Any]:
    """Return a plate lift that has whatever a document can have."""
    state = {"element": "edge", "index": 1, "with": "table", "vertices": [[0.0, 0.0, 0.0], [0.1, 0.0, 0.0]]}
    push = {"arm": "left", "body": "plate", "point": [0.0, 0.0, 0.0], "normal": [1.0, 0.0, 0.0]}
    both = {"grip": {**GRIP, "body": "plate"}, "push": push}
    contacts = [
        contact(0, "right", "soft_finger", (0.0, 0.0, 3.0), finger=0, eps=0.01),
        contact(0, "left", "point", (0.0, 0.0, 5.0)),
        contact(0, "table", "environment", (0.0, 0.0, 8.0)),
        contact(
            *(0, "cup", "suction", (0.0, 0.0, 6.0)),
            suction_force=11.0, radius=0.02, kappa=0.005, x_axis=[1.0, 0.0, 0.0],
        ),
        {
            **{"sample": 0, "body": "plate", "by": None, "kind": "inertia", "point": [0.0, 0.0, 1.1], "normal": None},
            "wrench": [0.0, 0.0, 0.1, 0.0, 0.0, 0.0],
        },
    ]  # fmt: skip
    document["segments"] = [
        segment(0.0, 2, kind="grip", contact_state=state, hold=both),
        segment(0.1, 2, kind="transfer", contact_state=state, hold=both, contacts=contacts),
    ]
    begun = lift(0.3)
    document["simulation"] = simulation(2.0, lift=begun, cause="a hand slipped")
    _fill(document)
    return document


@pytest.fixture(scope="module")
def tool_cell() -> Cell:
    return load_cell("dual_ur3e_tool")


@pytest.fixture
def moved(tool_cell: Cell) -> dict[str, Any]:
    """Return a plan of a suction tool that has whatever a document can have."""
    document = tool_document(tool_cell)
    document["segments"][2]["hold"] = hold(GRIP, OTHER)
    document["simulation"] = tool_simulation(1.5, outcome="object_dropped", failed_at=0.7, cause="it came off.")
    _fill(document)
    return document


def _fill(document: dict[str, Any]) -> None:
    figures = {"nodes": 12, "cost": 1.5, "minimised": "cost", "full": False, "inner": {"length": 3}, "tried": [1, 2]}
    document["statistics"] |= {
        "total_seconds": 2.0,
        "stages": [{"name": "certify", "seconds": 0.5}],
        "graph": {**figures, "contact_states": {"face": {"nodes": 3, "alive": 1, "dead": 2}}},
        "search": figures,
    }
    check = {"name": "balance", "passed": True, "margin": 0.1, "unit": "N", "where": "/segments/0"}
    document["certificate"] = {"passed": True, "checks": [check]}
    cause = {"reason": "too heavy", "needed": 3.0, "available": 2.0, "unit": "N", "where": "the plate"}
    document["explanation"] = {"summary": "told", "causes": [cause]}


@pytest.mark.parametrize("kind", ["lifted", "moved"])
@pytest.mark.parametrize("outcome", among(["solved", "infeasible", "not_found"], ["solved"]))
def test_every_null_and_gap_that_the_schema_allows_is_told(
    kind: str, outcome: str, request: pytest.FixtureRequest
) -> None:
    document = {**request.getfixturevalue(kind), "outcome": outcome}
    if outcome != "solved":
        document |= {"segments": [], "simulation": None}
    places = list(spots(SCHEMA, document))
    assert {(("certificate",), False), (("statistics", "search", "cost"), False)} <= set(places)
    faults: list[str] = []
    for place, left_out in places:
        try:
            plan = plan_of(changed(document, place, left_out=left_out))
        except ValidationError:
            assert place[-1] in NEEDED_BY_OTHERS, place
            continue
        try:
            words = [*_words(describe_plan(plan).model_dump(mode="json")), summarise(plan)]
        except (TypeError, KeyError, AttributeError, ValueError, IndexError) as error:
            faults.append(f"{'/'.join(map(str, place))} {'left out' if left_out else 'null'}: {error!r}")
        else:
            faults += [f"{'/'.join(map(str, place))}: {each!r}" for each in words if "None" in each]
    assert faults == []


def _words(told: Any) -> Iterator[str]:
    """Yield every text of a description."""
    if isinstance(told, str):
        yield told
    elif isinstance(told, Mapping):
        yield from (words for each in told.values() for words in _words(each))
    elif isinstance(told, list):
        yield from (words for each in told for words in _words(each))


def test_a_figure_that_there_is_none_of_is_a_dash(lifted: dict[str, Any]) -> None:
    lifted["statistics"]["search"] |= {"cost": None, "full": True}
    (rows,) = (group["rows"] for group in described(lifted)["figures"] if group["title"] == "Search")
    assert ["cost", "\u2013"] in rows
    assert ["full", "yes"] in rows


def test_an_unsolved_plan_says_that_there_is_nothing_to_certify(lifted: dict[str, Any]) -> None:
    for outcome in ("infeasible", "not_found"):
        told = summarise(plan_of({**lifted, "outcome": outcome, "segments": [], "certificate": None}))
        assert "certificate:    none, nothing to certify: no plan" in told.splitlines()


@pytest.mark.parametrize("kind", ["lifted", "moved"])
def test_a_plan_in_which_all_is_null_that_may_be_is_drawn(
    kind: str, request: pytest.FixtureRequest, cell: Cell, tool_cell: Cell, tmp_path_factory: pytest.TempPathFactory
) -> None:
    document = request.getfixturevalue(kind)
    # Inner places first: what is in a place that is null already is gone.
    nulls = [place for place, left_out in spots(SCHEMA, document) if not left_out and place[-1] not in NEEDED_BY_OTHERS]
    for place in sorted(nulls, key=lambda place: -len(place)):
        document = changed(document, place, left_out=False)
    assert document["certificate"] is document["simulation"] is document["segments"][0]["hold"] is None
    server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
    try:
        meshes = LinkMeshes(Path(tmp_path_factory.getbasetemp()) / "meshes")
        plan, drawn_in = plan_of(document), cell if kind == "lifted" else tool_cell
        scene = PlanScene(Stage(server.scene, "/stage", drawn_in, meshes), "/plan", Playback(plan))
        for layer in scene.layers:
            scene.set_layer(layer, True)
        for time in np.linspace(0.0, plan.duration, 7):
            scene.show("plan", float(time))
    finally:
        server.stop()
    described(document)
