"""Suction-tool tasks that no file lists, written in few words."""

from __future__ import annotations

import math
from typing import Any

from planners.contract.task_spec import SuctionToolTask, read_task
from planners.scene.tool_scene import SuctionToolScene, build_tool_scene

TABLE = 1.094
"""Height of the table [m]."""


def box(
    name: str, start: list[float], goal: list[float], size: tuple[float, float, float] = (0.1, 0.08, 0.05), **more: Any
) -> dict[str, Any]:
    """Describe a box between two places; (x, y) on the table, (x, y, yaw), or (x, y, yaw, height of its bottom)."""
    return {
        "name": name,
        "shape": {"type": "box", "size": list(size)},
        "mass": 0.15,
        "pose": pose(start, 0.5 * size[2]),
        "goal_pose": pose(goal, 0.5 * size[2]),
        "goal_symmetry": "shape",
        **more,
    }


def pose(place: list[float], middle: float) -> list[float]:
    """Return the seven numbers of a level body whose origin is `middle` above its bottom [m]."""
    x, y, yaw, bottom = [*place, 0.0, 0.0][:4] if len(place) < 4 else place
    return [x, y, TABLE + bottom + middle, math.cos(0.5 * yaw), 0.0, 0.0, math.sin(0.5 * yaw)]


def scene_of(*objects: dict[str, Any], **more: Any) -> SuctionToolScene:
    """Build the scene of a task with these objects."""
    task = read_task({"kind": "suction_tool", "objects": list(objects), **more})
    assert isinstance(task, SuctionToolTask)
    return build_tool_scene(task)
