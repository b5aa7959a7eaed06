"""A suction-tool task of many small boxes, as many as are accepted."""

from __future__ import annotations

from itertools import islice, product
from typing import Any

TABLE_TOP = 1.094
SIDE, HEIGHT, PITCH = 0.06, 0.04, 0.09
"""Of a box, and from box to box [m]."""
STEP = 0.02
"""How far every box has to go [m]."""
_ROOM = 0.15
"""On both sides of the plane of symmetry, for the tool in its rest [m]."""


def many_boxes(count: int) -> dict[str, Any]:
    """Return a task: boxes on a grid on both sides of the table, each to be moved a little outwards."""
    rows = [0.28 + PITCH * i for i in range(3)]
    columns = [side * (_ROOM + PITCH * j) for j in range(9) for side in (1.0, -1.0)]
    places = list(islice(product(columns, rows), count))
    assert len(places) == count
    return {
        "kind": "suction_tool",
        "objects": [
            {
                "name": f"box_{i}",
                "shape": {"type": "box", "size": [SIDE, SIDE, HEIGHT]},
                "mass": 0.05,
                "pose": [x, y, TABLE_TOP + HEIGHT / 2, 1, 0, 0, 0],
                "goal_pose": [x, y + (STEP if y > 0 else -STEP), TABLE_TOP + HEIGHT / 2, 1, 0, 0, 0],
                "goal_symmetry": "shape",
            }
            for i, (y, x) in enumerate(places)
        ],
    }
