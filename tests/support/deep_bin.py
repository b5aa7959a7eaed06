"""A part that has to go into a bin deeper than a hand is long, between four walls that are obstacles."""

from __future__ import annotations

from typing import Any

PART: dict[str, Any] = {
    "name": "part", "shape": {"type": "box", "size": [0.1, 0.06, 0.03]}, "mass": 0.2,
    "pose": [0.35, 0.3, 1.109, 1, 0, 0, 0], "goal_pose": [0.4, -0.3, 1.109, 1, 0, 0, 0],
}  # fmt: skip
WALLS: list[dict[str, Any]] = [
    {"name": name, "shape": {"type": "box", "size": [*size, 0.25]}, "pose": [*place, 1.219, 1, 0, 0, 0]}
    for name, size, place in (
        ("wall_front", (0.02, 0.2), (0.32, -0.3)),
        ("wall_back", (0.02, 0.2), (0.48, -0.3)),
        ("wall_left", (0.14, 0.02), (0.4, -0.21)),
        ("wall_right", (0.14, 0.02), (0.4, -0.39)),
    )
]
NAMES = frozenset(wall["name"] for wall in WALLS)
"""Of the walls."""
