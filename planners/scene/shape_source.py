"""From the shapes that a task names to solids; meshes are looked up."""

from __future__ import annotations

from dataclasses import dataclass

from planners.contract.shapes import Box, Cylinder, InlineMesh, Mesh, Prism
from planners.errors import SceneError
from planners.scene.solid import Solid, solid_of

PLANNED_SHAPES = ("box", "cylinder", "prism")
"""The types of shapes that can be planned with."""


@dataclass(frozen=True, eq=False)
class ShapeSource:
    """Turns shapes of a task into solids."""

    def find(
        self, shape: Box | Cylinder | Prism | Mesh, pointer: str
    ) -> tuple[Box | Cylinder | Prism | InlineMesh, Solid]:
        """Return a shape as a plan document states it, and its solid; `pointer` is where the task names it.

        Raises:
            SceneError: a mesh, which cannot be planned with yet.
        """
        if isinstance(shape, Mesh):
            raise SceneError(f"{pointer}/type", "meshes cannot be planned with yet", list(PLANNED_SHAPES))
        return shape, solid_of(shape)
