"""Piles that are built from random initial layouts: the shipped tasks, their objects strewn over the table."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from planners.cell.cell import Cell
from planners.contract.task_spec import SuctionToolTask, read_task
from planners.errors import SceneError
from planners.scene.tool_scene import build_tool_scene
from tests.benchmarks.tasks import task_body

X, Y = (0.15, 0.60), (-0.45, 0.45)
"""Where objects begin: as far as both arms together reach, and clear of the robot's column [m, world]."""


@dataclass(frozen=True)
class Pile:
    """What is piled up, with which tool."""

    name: str
    paper: str
    """The paper's name of its objects."""
    task: str
    """The shipped task that says the goals, the tool and how the objects lie."""
    tool: str
    objects: int


LONG, SHORT = "long_symmetric", "short_asymmetric"
PILES = (
    Pile("domino", "domino", "domino_pile", LONG, 3),
    Pile("can", "can", "can_stack", LONG, 2),
    Pile("tissue", "tissue", "tissue_pile", LONG, 3),
    Pile("tissue, short tool", "tissue", "tissue_pile_short_tool", SHORT, 3),
)
"""A seed strews the same objects the same way, whichever the tool."""


def strewn(pile: Pile, seed: int) -> dict[str, Any]:
    """Return the body of the pile's task with every object anywhere in the region, turned any way about the vertical.

    Nothing keeps objects apart: where they overlap the service refuses the layout. Nothing keeps them off the place of
    the pile either: where one stands there it has to be put aside.
    """
    body = strewn_about(task_body(pile.task), np.random.default_rng(seed))
    return {**body, "external_id": f"{pile.task}_{seed}", "seed": seed}


def strewn_about(body: dict[str, Any], rng: np.random.Generator, larger: float = 1.0) -> dict[str, Any]:
    """Return the body of a pile with every object anywhere in a region so many times as large [1]."""
    objects = []
    for each in body["objects"]:
        x, y, half = larger * rng.uniform(*X), larger * rng.uniform(*Y), 0.5 * rng.uniform(-np.pi, np.pi)
        pose = [x, y, each["pose"][2], float(np.cos(half)), 0.0, 0.0, float(np.sin(half))]
        objects.append({**each, "pose": pose})
    return {**body, "objects": objects}


def refusal(pile: Pile, seed: int, cells: dict[str, Cell] | None = None) -> str | None:
    """Return why the service refuses the layout of a seed; None where it accepts it."""
    task = read_task(strewn(pile, seed))
    assert isinstance(task, SuctionToolTask)
    try:
        build_tool_scene(task, cells)
    except SceneError as refused:
        return refused.detail
    return None
