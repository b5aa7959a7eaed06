"""Ways on the table: in the words of somebody who stands behind the robot, and towards where both arms reach best."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from planners.cell.cell import Cell
from planners.geometry.pose import Array
from planners.geometry.sides import AWAY, LEFT, RIGHT, TOWARDS

_BEST_REACH = 0.7
"""How far in front of the shoulders the place is that both arms reach best, as a share of an arm's reach [1]."""
_HEADING = 15.0
"""Ways whose headings are nearest to the same multiple lead the same way [deg]."""
_NOWHERE = 1e-6
"""A way that is shorter leads nowhere [m]."""


def straight_ways() -> tuple[Array, Array, Array, Array]:
    """Return the unit ways (2,) towards the robot, to the left, to the right and away, along the world's x and y."""
    away, left = np.eye(2)
    return -away, left, -left, away


def straightest(off: Array) -> Array:
    """Return the one of the straight ways (2,) that leads most the way `off` (2,) does [m]; of equals, away."""
    return max(reversed(straight_ways()), key=lambda way: float(way @ off))


def heading(way: Array) -> str:
    """Return which of 24 headings a way (2,) in the world has, counterclockwise from away from the robot."""
    return f"{round(np.degrees(np.arctan2(way[1], way[0])) / _HEADING) % round(360 / _HEADING)} of {360 / _HEADING:.0f}"


def told_way(way: Array) -> str:
    """Say how far and where a way (2,) in the world [m] leads, as in "50 mm to the left"; empty where nowhere."""
    parts = (
        (float(way[0]), AWAY, TOWARDS),
        (float(way[1]), LEFT, RIGHT),
    )
    told = [
        f"{1e3 * abs(length):.0f} mm {forward if length > 0.0 else back}"
        for length, forward, back in parts
        if abs(length) >= 0.5e-3
    ]
    return " and ".join(told)


def told_move(way: Array, start: Sequence[float]) -> str:
    """Say how far and where a way (2,) leads from a place, and to which x and y in the world [m].

    As in "50 mm to the left, to x = 300, y = -50 mm".

    Args:
        way: as said.
        start: begins with x and y of the place, as poses do.
    """
    x, y = (round(1e3 * (here + step)) for here, step in zip(start[:2], way.tolist(), strict=True))
    return f"{told_way(way)}, to x = {x}, y = {y} mm"


def way_to_best(cell: Cell, place: Sequence[float]) -> Array:
    """Return the way (2,) from a place, of which x and y count, to where both arms of a cell reach best [m, world]."""
    middle = between_arms(cell)
    to_table = cell.boxes[0].center[:2] - middle
    distance = float(np.linalg.norm(to_table))
    # Between arms that face each other nothing leads away from them.
    ahead = to_table / distance if distance > _NOWHERE else straight_ways()[-1]
    return middle + _BEST_REACH * least_reach(cell) * ahead - np.array(place[:2])


def between_arms(cell: Cell) -> Array:
    """Return the place (2,) in the middle between the bases of a cell's arms [m, world]."""
    return np.mean([arm.T_world_base[:2, 3] for arm in cell.arms.values()], axis=0)


def least_reach(cell: Cell) -> float:
    """Return how far the arm of a cell reaches that reaches less far [m]."""
    return min(arm.robot.reach for arm in cell.arms.values())
