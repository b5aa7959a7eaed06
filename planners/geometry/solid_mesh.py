"""A closed mesh that was taken in: its surface, and the convex parts that cover it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from planners.geometry.pose import Array
from planners.geometry.surface import Faces, centroid


@dataclass(frozen=True, eq=False)
class SolidMesh:
    """One solid, in its own frame and the unit of its file."""

    vertices: Array
    """(n, 3)"""
    faces: Faces
    """(m, 3), closed, counter-clockwise from outside."""
    parts: tuple[Array, ...]
    """Corners (k, 3) of convex parts whose union contains the solid."""
    excess: float
    """How far the parts reach beyond the solid."""

    @property
    def size(self) -> Array:
        """(3,) full lengths of the box around it."""
        return np.ptp(self.vertices, axis=0)

    @property
    def centroid(self) -> Array:
        """(3,) centre of mass, were it evenly filled."""
        return centroid(self.vertices, self.faces)

    def scaled(self, factor: float) -> SolidMesh:
        """Return the mesh with everything `factor` times as large."""
        parts = tuple(factor * part for part in self.parts)
        return SolidMesh(factor * self.vertices, self.faces, parts, factor * self.excess)

    def document(self) -> dict[str, Any]:
        """Return the mesh as JSON data."""
        return {
            "vertices": self.vertices.tolist(),
            "faces": self.faces.tolist(),
            "parts": [part.tolist() for part in self.parts],
            "excess": self.excess,
        }

    @classmethod
    def from_document(cls, document: Mapping[str, Any]) -> Self:
        """Read what `document` wrote."""
        return cls(
            np.array(document["vertices"], dtype=float).reshape(-1, 3),
            np.array(document["faces"], dtype=np.int64).reshape(-1, 3),
            tuple(np.array(part, dtype=float).reshape(-1, 3) for part in document["parts"]),
            float(document["excess"]),
        )
