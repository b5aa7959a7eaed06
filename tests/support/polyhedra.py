"""Normals of polyhedra, from their corners alone."""

from __future__ import annotations

import numpy as np

from planners.geometry.polyhedron import Polyhedron


def face_normal(body: Polyhedron, face: int) -> np.ndarray:
    """Return the outward unit normal (3,) of a face."""
    a, b, c = body.vertices[list(body.faces[face][:3])]
    normal = np.cross(b - a, c - b)
    return normal / np.linalg.norm(normal)
