"""Plan documents as JSON data, which a test may change before they are certified."""

from __future__ import annotations

import json
from collections.abc import Mapping
from functools import cache
from typing import Any

from planners.cell.cell import Cell
from planners.certify import CellReference, Certificate, CertifySettings, RobotSurfaces, certify, load_surfaces
from planners.certify.evidence import Evidence
from planners.certify.plan_view import read_plan
from planners.plan.plan import Plan


def sent(document: Mapping[str, Any]) -> bytes:
    """Write a document as the service sends it, whatever is in it."""
    return json.dumps(document).encode()


def plan_of(document: Mapping[str, Any]) -> Plan:
    """Read a document as if it had been sent."""
    return Plan.read(sent(document))


def certified(
    document: Mapping[str, Any],
    surfaces: RobotSurfaces,
    reference: CellReference | None = None,
    settings: CertifySettings | None = None,
) -> Certificate | None:
    """Certify a document as if it had been sent."""
    return certify(sent(document), surfaces, reference, settings)


def evidence_of(document: Mapping[str, Any], reference: CellReference | None = None) -> Evidence:
    """Return what an examination of a document has before it, for asking one check alone."""
    return Evidence(read_plan(sent(document)), _surfaces(), reference)


@cache
def _surfaces() -> RobotSurfaces:
    return load_surfaces()


def cell_of(cell: Cell) -> dict[str, Any]:
    """Return the member `cell` of documents of plans in a cell."""
    return cell.document().model_dump(mode="json", exclude_unset=True)


def bodies_of(cell: Cell) -> dict[str, dict[str, Any]]:
    """Return the entries of a cell's own bodies in the member `bodies`."""
    return {name: body.model_dump(mode="json") for name, body in cell.body_documents().items()}
