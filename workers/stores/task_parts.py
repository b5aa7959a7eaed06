"""What a task names and does not hold itself: uploaded meshes, and a cell of one's own."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NotRequired, TypedDict

from planners.cell.cell import known_cells
from planners.contract.uploads import named_uploads
from workers.stores.cell_store import CellStore
from workers.stores.mesh_store import MeshStore


class NamedParts(TypedDict):
    """As a solver process is sent them, see `workers.solver.protocol`."""

    meshes: dict[str, dict[str, object]]
    cell_folder: NotRequired[str]


@dataclass(frozen=True)
class TaskParts:
    """Finds them in the database."""

    meshes: MeshStore
    cells: CellStore

    def named_by(self, task: Mapping[str, Any]) -> NamedParts:
        """Return what a task, as accepted, names. One transaction each."""
        parts = NamedParts(meshes=self.meshes.documents(named_uploads(task)))
        cell = task.get("cell")
        if isinstance(cell, str) and cell not in known_cells():
            folder = self.cells.unpacked(cell)
            if folder is not None:
                parts["cell_folder"] = str(folder)
        return parts
