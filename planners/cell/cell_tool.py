"""A suction tool that a cell brings, with the meshes of its parts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planners.cell.asset_files import ToolFile, ToolMeshFile, ToolPartFile
from planners.cell.asset_shelf import AssetShelf, fingerprint, known_meshes, read_mesh_asset, read_tool_file
from planners.contract.shapes import Box, Cylinder, InlineMesh, Mesh, Prism
from planners.contract.task_spec import ToolCup
from planners.errors import AssetError, AssetFault, AssetFaults
from planners.geometry.pose import Array
from planners.geometry.solid_mesh import SolidMesh, take_mesh
from planners.plan.scenery import ToolDocument, ToolPartDocument

LONGEST_MESH = 2.0
"""Of a part of a tool [m]: as of the meshes of tasks, what is longer was most likely drawn in another unit."""


@dataclass(frozen=True, eq=False)
class CellToolPart:
    """One part of a tool."""

    shape: Box | Cylinder | Prism | SolidMesh
    """A mesh is in metres."""
    pose: Array
    """(7,) shape frame in the tool frame."""

    @property
    def stated(self) -> Box | Cylinder | Prism | InlineMesh:
        """The shape as plan documents state it."""
        shape = self.shape
        return InlineMesh.of(shape.vertices, shape.faces, shape.parts) if isinstance(shape, SolidMesh) else shape


@dataclass(frozen=True, eq=False)
class CellTool:
    """A suction tool that a cell brings."""

    file: ToolFile
    parts: tuple[CellToolPart, ...]

    @property
    def fingerprint(self) -> str:
        """Hash of all that it is made of, meshes included."""
        meshes = [part.shape for part in self.parts if isinstance(part.shape, SolidMesh)]
        contents = [array.tobytes() for mesh in meshes for array in (mesh.vertices, mesh.faces)]
        return fingerprint([self.file.model_dump_json().encode(), *contents])

    def document(self) -> ToolDocument:
        """Return what a plan's `cell` states of it."""
        tool = self.file.tool
        cup = ToolCup(radius=tool.cup.radius, max_force=tool.cup.max_force, mu=tool.cup.mu, kappa=tool.cup.kappa)
        return ToolDocument(
            shapes=tuple(ToolPartDocument(shape=part.stated, pose=part.pose) for part in self.parts),
            mass=tool.mass,
            com=np.array(tool.com),
            cup=cup,
        )


def load_cell_tool(name: str, shelf: AssetShelf) -> CellTool:
    """Load a tool from a cell's own folders.

    Raises:
        AssetError: Something is wrong with it; every fault has its member of the tool's file.
    """
    path = shelf.find("tools", name)
    file, faults, parts = read_tool_file(path), AssetFaults(), list[CellToolPart]()
    for i, part in enumerate(file.tool.shapes):
        with faults.at(str(path), f"/tool/shapes/{i}/{'mesh' if isinstance(part, ToolMeshFile) else 'shape/asset'}"):
            parts.append(CellToolPart(_shape(part, shelf), np.array(part.pose)))
    faults.raise_any()
    return CellTool(file, tuple(parts))


def _shape(part: ToolPartFile, shelf: AssetShelf) -> Box | Cylinder | Prism | SolidMesh:
    if isinstance(part, ToolMeshFile):
        return shelf.solid(part.mesh, LONGEST_MESH)
    shape = part.shape
    if not isinstance(shape, Mesh):
        return shape
    # An upload is none of a cell's: the file's model refuses it.
    if shape.asset is None or shape.asset not in known_meshes():
        raise AssetError(AssetFault(f"there is no mesh {shape.asset}", allowed=tuple(known_meshes())))
    return take_mesh(*read_mesh_asset(shape.asset)).scaled(shape.scale)
