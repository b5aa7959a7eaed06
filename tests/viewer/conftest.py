"""A small plan of a lift, and the cell that it is in."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from planners.cell.cell import Cell, load_cell
from tests.support.lift_documents import lift_document
from tests.support.plan_shelf import PlanShelf


@pytest.fixture(scope="module")
def data_dir(shelf: PlanShelf, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return where a service keeps what is its own; the drawings of robots are made once in a run."""
    folder = tmp_path_factory.mktemp("data")
    (folder / "drawings").symlink_to(shelf.drawings)
    return folder


@pytest.fixture(scope="session")
def cell() -> Cell:
    return load_cell("dual_ur3e_lift")


@pytest.fixture
def document(cell: Cell) -> dict[str, Any]:
    """Return a plan without segments."""
    return lift_document(cell)
