"""From the shapes that a task names to solids; meshes are looked up among the shipped ones and the uploads."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache, lru_cache

from planners.cell.asset_shelf import known_meshes, read_mesh_asset
from planners.contract.shapes import Box, Cylinder, InlineMesh, Mesh, Prism
from planners.errors import SceneError
from planners.geometry.solid_mesh import SolidMesh, take_mesh
from planners.scene.solid import MeshSolid, Solid, solid_of

PLANNED_SHAPES = ("box", "cylinder", "prism", "mesh")
"""The types of shapes that can be planned with."""
LONGEST_MESH = 2.0
"""What is longer does not fit into a cell: most likely its unit is not the metre [m]."""
MILLIMETRE = 1e-3
"""The scale of a mesh in millimetres."""
SHORTEST_MESH = 1e-3
"""What is shorter cannot be handled [m]."""

Uploads = Callable[[str], SolidMesh | None]
"""Finds the mesh of an upload's id; None if there is none."""


def no_uploads(upload: str) -> SolidMesh | None:
    """Know of no upload."""
    return None


@dataclass(frozen=True, eq=False)
class ShapeSource:
    """Turns shapes of a task into solids."""

    uploads: Uploads = no_uploads
    _found: dict[Mesh, tuple[InlineMesh, MeshSolid]] = field(default_factory=dict, init=False, repr=False)
    """Meshes that were asked for: ten equal objects share one."""

    def find(
        self, shape: Box | Cylinder | Prism | Mesh, pointer: str
    ) -> tuple[Box | Cylinder | Prism | InlineMesh, Solid]:
        """Return a shape as a plan document states it, and its solid; `pointer` is where the task names it.

        Raises:
            SceneError: There is no such mesh, or it is as large or as small as no thing in a cell.
        """
        if not isinstance(shape, Mesh):
            return shape, solid_of(shape)
        if shape not in self._found:
            mesh = self._mesh(shape, pointer)
            _check_size(mesh, shape.scale, pointer)
            self._found[shape] = _stated_and_solid(mesh, shape.scale)
        return self._found[shape]

    def _mesh(self, shape: Mesh, pointer: str) -> SolidMesh:
        if shape.asset is not None:
            if shape.asset not in known_meshes():
                raise SceneError(f"{pointer}/asset", f"there is no mesh {shape.asset}", known_meshes())
            return _shipped(shape.asset)
        assert shape.upload is not None
        mesh = self.uploads(shape.upload)
        if mesh is None:
            raise SceneError(f"{pointer}/upload", f"there is no upload {shape.upload}; POST the file to /v1/meshes")
        return mesh


@cache
def _shipped(asset: str) -> SolidMesh:
    return take_mesh(*read_mesh_asset(asset))


@lru_cache(maxsize=16)
def _stated_and_solid(mesh: SolidMesh, scale: float) -> tuple[InlineMesh, MeshSolid]:
    """Return a mesh of a file as a plan document states it, and its solid: its faces are found once for all scenes."""
    mesh = mesh.scaled(scale)
    return InlineMesh.of(mesh.vertices, mesh.faces, mesh.parts), mesh_solid(mesh)


def mesh_solid(mesh: SolidMesh) -> MeshSolid:
    """Return a mesh in metres as a solid."""
    return MeshSolid(mesh.vertices, mesh.faces, mesh.drawn.parts, mesh.drawn.excess)


def _check_size(mesh: SolidMesh, scale: float, pointer: str) -> None:
    longest = scale * float(mesh.size.max())
    if longest > LONGEST_MESH:
        detail = f"the mesh is {longest:.4g} m long, more than {LONGEST_MESH:g} m"
        hint = f"; if the unit of its file is the millimetre, scale is {MILLIMETRE:g}"
        raise SceneError(f"{pointer}/scale", detail + hint)
    if longest < SHORTEST_MESH:
        detail = f"the mesh is {1e3 * longest:.4g} mm long, less than {1e3 * SHORTEST_MESH:g} mm"
        raise SceneError(f"{pointer}/scale", detail)
