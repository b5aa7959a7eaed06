"""What a task names and does not hold itself: uploaded meshes, and a cell of one's own."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

from planners.cell.cell import known_cells
from planners.contract.shapes import named_uploads
from planners.geometry.solid_mesh import MeshDocument
from workers.stores.cell_store import CellStore
from workers.stores.mesh_store import MeshStore


class NamedParts(NamedTuple):
    """As a solver process is sent them, see `workers.solver.protocol`."""

    meshes: Mapping[str, MeshDocument]
    """By id."""
    cell_folder: str | None
    """None: its cell is shipped, or not kept any more."""


@dataclass(frozen=True)
class TaskParts:
    """Finds them in the database."""

    meshes: MeshStore
    cells: CellStore

    def named_by(self, task: Mapping[str, Any]) -> NamedParts:
        """Return what a task, as accepted, names. One transaction each."""
        cell, folder = task.get("cell"), None
        if isinstance(cell, str) and cell not in known_cells():
            folder = self.cells.unpacked(cell)
        return NamedParts(self.meshes.documents(named_uploads(task)), None if folder is None else str(folder))
