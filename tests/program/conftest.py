"""Plans that become programs: whole ones, made once, and a small one that only says of itself that it is certified."""

from __future__ import annotations

import pytest

from planners.cell.cell import load_cell
from planners.plan.plan import Plan
from tests.support.documents import plan_of
from tests.support.lift_documents import lift_document, segment
from tests.support.plan_shelf import PlanShelf
from tests.support.service import task
from workers.solver.protocol import SolverRequest

TASKS = ("ab1", "domino_pile")


@pytest.fixture(scope="session")
def documents(shelf: PlanShelf) -> dict[str, bytes]:
    """Return the documents of `TASKS`, by name."""
    return {name: shelf.take(SolverRequest(name, task(f"{name}.json")), lambda _: None) for name in TASKS}


@pytest.fixture(scope="session")
def plans(documents: dict[str, bytes]) -> dict[str, Plan]:
    """Return the plans of `TASKS`, by name."""
    return {name: Plan.read(document) for name, document in documents.items()}


@pytest.fixture(scope="session")
def small() -> Plan:
    """Return a document that says of itself that it is certified, and is sealed."""
    cell = load_cell("dual_ur3e_lift")
    check = {"name": "structure", "passed": True, "margin": 0.0, "unit": "1", "where": "the whole document"}
    members = {"outcome": "solved", "segments": [segment(0.0, 3)], "certificate": {"passed": True, "checks": [check]}}
    return plan_of({**lift_document(cell), **members}).sealed()
