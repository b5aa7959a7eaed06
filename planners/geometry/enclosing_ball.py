"""A ball around points, close to the least one (compiled)."""

from __future__ import annotations

import numpy as np
from numba import njit

from planners.geometry.pose import Array

_STEPS = 200
"""Leave a ball less than 1 % too large."""


@njit(cache=True, nogil=True)
def enclosing_ball(vertices: Array) -> Array:
    """Return a ball (centre, radius) around points, close to the least one.

    Badoiu, Clarkson, "Smaller core-sets for balls" (2003): walk towards the farthest point by ever smaller steps.
    """
    center = np.zeros(3)
    for k in range(3):
        center[k] = 0.5 * (vertices[:, k].min() + vertices[:, k].max())
    best = np.zeros(4)
    best[3] = np.inf
    for step in range(_STEPS):
        farthest, square = 0, -1.0
        for i in range(len(vertices)):
            x, y, z = vertices[i, 0] - center[0], vertices[i, 1] - center[1], vertices[i, 2] - center[2]
            if x * x + y * y + z * z > square:
                farthest, square = i, x * x + y * y + z * z
        if square < best[3]:
            best[:3], best[3] = center, square
        center += (vertices[farthest] - center) / (step + 2)
    best[3] = np.sqrt(best[3])
    return best
