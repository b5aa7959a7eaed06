"""Whatever is in a document, the certificate is an answer and never an exception."""

from __future__ import annotations

import copy
import json
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from planners.certify import RobotSurfaces, certify

Document = dict[str, Any]
UNREAD = {"id", "seed", "software", "certificate", "simulation", "statistics", "explanation"}
"""Members that say nothing about the motion of a solved plan."""
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


@pytest.mark.parametrize("seed", range(4))
def test_nonsense_anywhere_is_answered_with_a_certificate(
    seed: int, honest_document: Document, surfaces: RobotSurfaces
) -> None:
    rng = np.random.default_rng(seed)
    places = [path for path in paths(honest_document) if path[0] not in UNREAD]
    for _ in range(30):
        document = copy.deepcopy(honest_document)
        path = places[rng.integers(len(places))]
        parent_of(document, path)[path[-1]] = NONSENSE[rng.integers(len(NONSENSE))]
        certificate = certify(document, surfaces)
        json.dumps(certificate.to_document(), allow_nan=False)


@pytest.mark.parametrize("root", [None, [], "plan", 1.0, {}, {"schema_version": "1.0"}])
def test_what_is_no_document_fails_its_structure(root: Any, surfaces: RobotSurfaces) -> None:
    certificate = certify(root, surfaces)
    assert [check.name for check in certificate.failures] == ["structure"]


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
            if (prefix, key) in {(("cell",), "name"), (("cell",), "hash"), (("segments", 4, "contact_state"), "index")}:
                continue
            document = copy.deepcopy(honest_document)
            del parent_of(document, (*prefix, None))[key]
            (failure,) = certify(document, surfaces).failures
            pointer = "/" + "/".join(map(str, (*prefix, key)))
            assert (failure.name, failure.where) == ("structure", f"{pointer}: is missing")


def test_a_string_among_the_positions_is_named_by_its_path(document: Document, surfaces: RobotSurfaces) -> None:
    document["segments"][1]["positions"][17][4] = "0.1"
    (failure,) = certify(document, surfaces).failures
    assert failure.where == "/segments/1/positions/17/4: must be a number"


@pytest.mark.parametrize("outcome", ["infeasible", "not_found"])
def test_a_plan_without_a_solution_needs_a_reason_and_no_motion(
    outcome: str, document: Document, surfaces: RobotSurfaces
) -> None:
    document["outcome"] = outcome
    assert not certify(document, surfaces).passed
    document["segments"] = []
    assert certify(document, surfaces).passed
    document["explanation"] = None
    assert not certify(document, surfaces).passed
