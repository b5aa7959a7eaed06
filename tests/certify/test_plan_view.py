"""Whatever is in a document, the certificate is an answer and never an exception."""

from __future__ import annotations

import copy
import json
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from planners.certify import RobotSurfaces
from planners.geometry.pose import rotation_x, to_pose7, transform
from tests.support.documents import certified
from tests.support.samples import sample

Document = dict[str, Any]
UNREAD = {"id", "seed", "software", "certificate", "simulation", "statistics", "explanation"}
"""Members that say nothing about the motion of a solved plan."""
OPTIONAL = {
    (("cell", "arms", "left"), "links"),
    (("cell", "arms", "left"), "torque_max"),
    (("cell", "hands", "left"), "com"),
}
"""Members that a document may lack: what is not said is not checked, or taken from what is known of the cell."""
NONSENSE = [None, "1", True, float("nan"), float("inf"), -1, 1e300, 10**400, [], {}, [[]], "left", 1e8, 1e-12]


def paths(value: Any, prefix: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """All places in a document, of long arrays the third and the last."""
    items: Any = ()
    if isinstance(value, dict):
        items = value.items()
    elif isinstance(value, list):
        items = [(i, value[i]) for i in sorted({min(2, len(value) - 1), len(value) - 1}) if value]
    for key, member in items:
        yield (*prefix, key)
        yield from paths(member, (*prefix, key))


def parent_of(document: Document, path: tuple[Any, ...]) -> Any:
    for key in path[:-1]:
        document = document[key]
    return document


@pytest.mark.parametrize("seed", range(sample(quick=1, whole=4)))
@pytest.mark.slow
def test_nonsense_anywhere_is_answered_with_a_certificate(
    seed: int, honest_document: Document, surfaces: RobotSurfaces
) -> None:
    answer_nonsense(honest_document, UNREAD, seed, surfaces)


@pytest.mark.parametrize("seed", range(sample(quick=1, whole=4)))
def test_nonsense_in_a_plan_without_a_solution_is_answered_with_a_certificate(
    seed: int, honest_document: Document, surfaces: RobotSurfaces
) -> None:
    cause = {"reason": "too heavy", "needed": 70.0, "available": 59.0, "unit": "N", "where": "capacity"}
    explanation = {"summary": "because", "causes": [cause]}
    unsolved = honest_document | {"outcome": "infeasible", "segments": [], "explanation": explanation}
    answer_nonsense(unsolved, UNREAD - {"explanation"}, seed, surfaces)


def answer_nonsense(honest: Document, unread: set[str], seed: int, surfaces: RobotSurfaces) -> None:
    rng = np.random.default_rng(seed)
    places = [path for path in paths(honest) if path[0] not in unread]
    for _ in range(30):
        document = copy.deepcopy(honest)
        path = places[rng.integers(len(places))]
        parent_of(document, path)[path[-1]] = NONSENSE[rng.integers(len(NONSENSE))]
        certificate = certified(document, surfaces)
        json.dumps(certificate.model_dump(), allow_nan=False)


@pytest.mark.parametrize("root", [None, [], "plan", 1.0, {}, {"schema_version": "1.0"}])
def test_what_is_no_document_fails_its_structure(root: Any, surfaces: RobotSurfaces) -> None:
    certificate = certified(root, surfaces)
    assert [check.name for check in certificate.failures] == ["structure"]


@pytest.mark.slow
def test_a_missing_member_is_named_by_its_path(honest_document: Document, surfaces: RobotSurfaces) -> None:
    """The members of a segment, of its hold, of a contact, of the cell: each in its turn."""
    prefixes = [
        ("cell",),
        ("cell", "arms", "left"),
        ("cell", "hands", "left"),
        ("bodies", "plate"),
        ("segments", 4),
        ("segments", 4, "hold", "grip"),
        ("segments", 4, "hold", "push"),
        ("segments", 4, "contact_state"),
        ("task", "cup"),
        ("task", "friction"),
    ]
    for prefix in prefixes:
        members = parent_of(honest_document, (*prefix, None))
        for key in members:
            if (prefix, key) in OPTIONAL:
                continue
            document = copy.deepcopy(honest_document)
            del parent_of(document, (*prefix, None))[key]
            (failure,) = certified(document, surfaces).failures
            pointer = "/" + "/".join(map(str, (*prefix, key)))
            assert (failure.name, failure.where) == ("structure", f"{pointer}: is missing")


def test_a_string_among_the_positions_is_named_by_its_path(document: Document, surfaces: RobotSurfaces) -> None:
    document["segments"][1]["positions"][17][4] = "0.1"
    (failure,) = certified(document, surfaces).failures
    assert failure.where == "/segments/1/positions/17/4: must be a number"


@pytest.mark.parametrize("outcome", ["infeasible", "not_found"])
def test_a_plan_without_a_solution_needs_a_reason_and_no_motion(
    outcome: str, document: Document, surfaces: RobotSurfaces
) -> None:
    def structure() -> bool:
        """Of what was not found nothing but the structure is looked at, and no certificate written when it is right."""
        certificate = certified(document, surfaces)
        return certificate is None or certificate.checks[0].passed

    document["outcome"] = outcome
    assert not structure()
    document["segments"] = []
    assert structure()
    assert (certified(document, surfaces) is None) == (outcome == "not_found")
    document["explanation"] = {"summary": "", "causes": []}
    assert not structure()
    document["explanation"] = None
    assert not structure()


def stand_on_the_table(document: Document) -> None:
    """Make the block under the plate the table, what was the table a part of the cell, and put a board beside it."""
    bodies = document["bodies"]
    board = {"shape": {"type": "box", "size": [0.05, 0.1, 0.4]}, "pose": [0.75, 0.0, 1.294, 1.0, 0.0, 0.0, 0.0]}
    bodies["floor"] = bodies["table"] | {"role": "frame"}
    bodies["table"] = bodies["support"] | {"role": "table"}
    bodies["support"] = bodies["support"] | board
    document["task"]["support"] = board
    for segment in document["segments"]:
        if segment["contact_state"]["with"] is not None:
            segment["contact_state"]["with"] = "table"
        for contact in segment["contacts"]:
            if contact["by"] == "support":
                contact["by"] = "table"


def test_a_plate_on_the_table_passes_beside_a_support_that_it_does_not_rest_on(
    document: Document, surfaces: RobotSurfaces
) -> None:
    stand_on_the_table(document)
    certificate = certified(document, surfaces)
    assert {check.name: check.where for check in certificate.failures} == {}


def test_a_support_beside_the_plate_bears_nothing(document: Document, surfaces: RobotSurfaces) -> None:
    stand_on_the_table(document)
    for contact in document["segments"][3]["contacts"]:
        if contact["kind"] == "environment":
            contact["by"] = "support"
    (failure,) = certified(document, surfaces).failures
    assert failure.name == "contact_points"
    assert "plate rests on table" in failure.where


def test_a_tilted_board_as_high_as_the_plate_is_no_support(document: Document, surfaces: RobotSurfaces) -> None:
    """Its highest edge is nearer to the plate's lowest face than the table is, but no face of it is."""
    stand_on_the_table(document)
    document["bodies"]["table"]["pose"][2] -= 2e-4
    board = document["bodies"]["support"]
    turn = transform(rotation_x(np.radians(20.0)))
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * np.array([0.05, 0.1, 0.1]) / 2
    reach = float((corners @ turn[2, :3]).max())
    document["task"]["support"] = {
        "shape": {"type": "box", "size": [0.05, 0.1, 0.1]},
        "pose": to_pose7(transform(turn[:3, :3], [0.75, 0.0, 1.244 - reach])),
    }
    board |= document["task"]["support"]
    assert certified(document, surfaces).passed
