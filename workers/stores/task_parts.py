"""What tasks name and do not hold themselves: uploaded meshes, and cells of one's own."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
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
    cell_folders: Mapping[str, str]
    """By name, as tasks say it; cells that are shipped, or not kept any more, are left out."""


@dataclass(frozen=True)
class TaskParts:
    """Finds them in the database."""

    meshes: MeshStore
    cells: CellStore

    def named_by(self, tasks: Iterable[Mapping[str, Any]]) -> NamedParts:
        """Return what some tasks, as accepted, name. One transaction for all meshes, and one for each cell."""
        every = [*tasks]
        uploads = frozenset().union(*map(named_uploads, every))
        cells = sorted({str(task["cell"]) for task in every}.difference(known_cells()))
        folders = {cell: str(folder) for cell in cells if (folder := self.cells.unpacked(cell)) is not None}
        return NamedParts(self.meshes.documents(uploads), folders)
