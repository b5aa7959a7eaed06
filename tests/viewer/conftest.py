"""A small plan of a lift, and the cell that it is in."""

from __future__ import annotations

from typing import Any

import pytest
from support.lift_documents import lift_document

from planners.cell.cell import Cell, load_cell


@pytest.fixture(scope="session")
def cell() -> Cell:
    return load_cell("dual_ur3e_lift")


@pytest.fixture
def document(cell: Cell) -> dict[str, Any]:
    """Return a plan without segments."""
    return lift_document(cell)
