"""Plate lifts drawn at random around the papers' five: plates, where they lie, their masses, and where the cup sits."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import numpy as np

from planners.cell.cell import Cell
from planners.contract.task_spec import PlateLiftTask, read_task
from planners.errors import SceneError
from planners.geometry.pose import Array
from planners.scene.scene import build_scene

BOXES = 0.7
"""Share of plates that are boxes; the others are regular prisms of a few corners."""
CORNERS = (3, 5, 6, 8)
SIDE = (0.26, 0.42)
"""Of a box, one side; of a prism, across its corners [m]. The papers': 0.3 to 0.5."""
ASPECT = (0.8, 1.25)
"""The box's other side over this one [1]."""
THICKNESS = (0.025, 0.050)
"""[m]; the papers': 0.040 and 0.044."""
X, Y, YAW = (0.27, 0.35), (-0.04, 0.04), (-25.0, 25.0)
"""Where the plate lies [m, degrees]; the papers': 0.3, 0, and 0 or 20."""
BOARDED = 0.25
"""Share of plates that lie on a board, as AB3 does."""
BOARD, RIM = (0.030, 0.050), 0.015
"""Thickness of a board, and how far it reaches beyond the plate [m]."""
OFF_CENTRE, OFFSET = 0.5, (-0.010, 0.010)
"""Share of plates whose centre of mass is not the middle, and how far off it is along either axis [m]."""
CUP_FORCE = (20.0, 60.0)
"""[N]: the papers' two cups and what is between them."""
WIDE_CUP = 40.0
"""From this force on the cup is the wider one of the papers' [N]."""
RADII = (0.0175, 0.0275)
"""[m]"""
USED, HANDS = (0.75, 0.95), (6.0, 20.0)
"""How much of the weight cup (share of its force) and hands [N] bear when the plate hangs level; AB1: 1 and 19 N."""
PLACE = (0.7, 1.1)
"""How far the cup is from the centre of mass, over the distance at which hands at the rim balance it so [1]."""
GRIP_DEPTH = 0.02
"""How far from the rim the hands bear [m]."""
FRONT_OR_BACK, ASIDE = 0.85, 30.0
"""Share of cups towards or away from the robot, and how far aside these may be [degrees]; others are anywhere around.
A cup exactly sideways leaves both hands one side to bear, which they seldom can."""


def drawn(seed: int) -> dict[str, Any]:
    """Return the body of the task of a seed; nothing says that it can be solved, or that it is accepted."""
    rng = np.random.default_rng(seed)
    outline, shape = _plate(rng)
    board = rng.uniform(*BOARD) if rng.random() < BOARDED else 0.0
    x, y, yaw = rng.uniform(*X), rng.uniform(*Y), np.radians(rng.uniform(*YAW))
    com = rng.uniform(*OFFSET, 2) if rng.random() < OFF_CENTRE else np.zeros(2)
    force = rng.uniform(*CUP_FORCE)
    pull, hands = rng.uniform(*USED) * force, rng.uniform(*HANDS)
    azimuth = _azimuth(rng) - yaw
    away = np.array([np.cos(azimuth), np.sin(azimuth)])
    lever = float(np.max(-(outline - com) @ away)) - GRIP_DEPTH
    cup = com + rng.uniform(*PLACE) * hands / pull * lever * away
    half = 0.5 * shape["height"] if shape["type"] == "prism" else 0.5 * shape["size"][2]
    body = {
        "kind": "plate_lift",
        "external_id": f"random_{seed}",
        "plate": {"shape": shape, "mass": _rounded((pull + hands) / 9.81), "com": [*map(_rounded, com), 0.0]},
        "plate_pose": _pose(x, y, TABLE + board + half, yaw),
        "cup": {"position": [*map(_rounded, cup)], "radius": RADII[force >= WIDE_CUP], "max_force": _rounded(force)},
        "seed": seed,
    }
    if board > 0.0:
        side = _rounded(2.0 * (float(np.abs(outline).max()) + RIM))
        size = [side, side, board]
        pose = _pose(x, y, TABLE + 0.5 * board, yaw)
        body["support"] = {"shape": {"type": "box", "size": size}, "pose": pose}
    return body


TABLE = 1.094
"""Height of the table of the shipped cells [m]."""


def refusal(seed: int, cells: Mapping[str, Cell] | None = None) -> str | None:
    """Return why the service refuses the task of a seed, with no figures in it; None where it accepts it."""
    task = read_task(drawn(seed))
    assert isinstance(task, PlateLiftTask)
    try:
        build_scene(task, cells)
    except SceneError as refused:
        return re.sub(r"\d+(\.\d+)?(e-?\d+)?", "…", refused.detail.partition("; moved ")[0])
    return None


def _plate(rng: np.random.Generator) -> tuple[Array, dict[str, Any]]:
    """Draw a plate: its outline (n, 2) [m], and its shape as a task tells it."""
    side, height = rng.uniform(*SIDE), _rounded(rng.uniform(*THICKNESS))
    if rng.random() < BOXES:
        size = [_rounded(side), _rounded(side * rng.uniform(*ASPECT)), height]
        half = 0.5 * np.array(size[:2])
        return half * [[-1, -1], [1, -1], [1, 1], [-1, 1]], {"type": "box", "size": size}
    corners = int(rng.choice(CORNERS))
    angles = 2.0 * np.pi * np.arange(corners) / corners
    outline = np.round(0.5 * side * np.column_stack([np.cos(angles), np.sin(angles)]), 6)
    return outline, {"type": "prism", "outline": outline.tolist(), "height": height}


def _azimuth(rng: np.random.Generator) -> float:
    """Draw in which direction of the world the cup is off the centre of mass [rad]."""
    if rng.random() >= FRONT_OR_BACK:
        return rng.uniform(-np.pi, np.pi)
    return np.pi * rng.integers(2) + np.radians(rng.uniform(-ASIDE, ASIDE))


def _pose(x: float, y: float, z: float, yaw: float) -> list[float]:
    return [x, y, z, float(np.cos(0.5 * yaw)), 0.0, 0.0, float(np.sin(0.5 * yaw))]


def _rounded(value: float) -> float:
    """Round to 0.1 mm, 0.1 g or 0.1 mN, so that a task can be read and repeated by hand."""
    return round(float(value), 4)
