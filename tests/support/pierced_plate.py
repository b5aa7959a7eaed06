"""A plate with a rectangular hole right through it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def pierced_plate(size: Array, low: Array, high: Array) -> tuple[Array, NDArray[np.intp]]:
    """Return vertices and outward triangles of a plate (3,) about the origin; its hole is from `low` to `high` (2,)."""
    lines = [(-half, first, last, half) for half, first, last in zip(size[:2] / 2, low, high, strict=True)]
    grid = np.array([[x, y, z] for z in (-size[2] / 2, size[2] / 2) for x in lines[0] for y in lines[1]])
    cells = [(i, j) for i in range(3) for j in range(3) if (i, j) != (1, 1)]
    corners = [np.add((i, j), [(0, 0), (1, 0), (1, 1), (0, 1)]) @ [4, 1] for i, j in cells]
    top = np.array([[(a, b, c), (a, c, d)] for a, b, c, d in corners]).reshape(-1, 3)
    # What one triangle of the top alone has is a border, with a wall below.
    sides = {(int(a), int(b)) for face in top for a, b in zip(face, np.roll(face, -1), strict=True)}
    walls = [((a + 16, a, b), (a + 16, b, b + 16)) for a, b in sides if (b, a) not in sides]
    return grid, np.vstack([top + 16, top[:, ::-1], np.array(walls).reshape(-1, 3)])
