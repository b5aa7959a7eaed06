"""Ways on the table towards where both arms reach best."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from planners.cell.cell import Cell
from planners.geometry.pose import Array

_BEST_REACH = 0.7
"""How far in front of the shoulders the place is that both arms reach best, as a share of an arm's reach [1]."""
_NOWHERE = 1e-6
"""A way that is shorter leads nowhere [m]."""


def way_to_best(cell: Cell, place: Sequence[float]) -> Array:
    """Return the way (2,) from a place, of which x and y count, to where both arms of a cell reach best [m, world]."""
    middle = between_arms(cell)
    to_table = cell.boxes[0].center[:2] - middle
    distance = float(np.linalg.norm(to_table))
    # Between arms that face each other nothing leads away from them.
    ahead = to_table / distance if distance > _NOWHERE else np.array([1.0, 0.0])
    return middle + _BEST_REACH * least_reach(cell) * ahead - np.array(place[:2])


def between_arms(cell: Cell) -> Array:
    """Return the place (2,) in the middle between the bases of a cell's arms [m, world]."""
    return np.mean([arm.T_world_base[:2, 3] for arm in cell.arms.values()], axis=0)


def least_reach(cell: Cell) -> float:
    """Return how far the arm of a cell reaches that reaches less far [m]."""
    return min(arm.robot.reach for arm in cell.arms.values())
