"""Sides, in the words of somebody who stands behind the robot: the world's x leads away from it, its y to the left."""

from __future__ import annotations

from typing import Literal

import numpy as np

from planners.geometry import polygon
from planners.geometry.pose import Array

AWAY, TOWARDS = "away from the robot", "towards the robot"
LEFT, RIGHT = "to the left", "to the right"
_ASIDE = float(np.sin(np.pi / 8.0))
"""What leads less to a side than this share of its way leads straight on: nearest of eight headings [1]."""


def told_heading(way: Array) -> str:
    """Say which of the eight headings is nearest to a way (2,) in the world, as in "to the left"."""
    ahead, left = (float(part) for part in way / np.linalg.norm(way))
    told = [
        forward if share > 0.0 else back
        for share, forward, back in ((ahead, AWAY, TOWARDS), (left, LEFT, RIGHT))
        if abs(share) > _ASIDE
    ]
    return " and ".join(told)


def told_side(outline: Array, R_world_body: Array, element: Literal["edge", "vertex"], index: int) -> str:
    """Say to which side of a lying prism one of its edges or vertices is, as seen from above.

    Args:
        outline: (n, 2) of the prism, counter-clockwise; edge k leads from vertex k to the next one [m].
        R_world_body: how the prism lies.
        element: which of both.
        index: its number.
    """
    outward = -polygon.inward_normals(outline)
    way = outward[index] if element == "edge" else outward[index - 1] + outward[index]
    return told_heading((R_world_body[:3, :2] @ way)[:2])
