"""Piles that are built from random initial layouts: the shipped tasks, their objects strewn over the table."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from planners.contract.task_spec import SuctionToolTask, read_task
from planners.errors import SceneError
from planners.regrasp.object_order import ObjectOrder
from planners.scene.cell import Cell
from planners.scene.tool_scene import SuctionToolScene, build_tool_scene
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


@dataclass(frozen=True, eq=False)
class Layout:
    """A start that every check of the service accepts."""

    pile: Pile
    seed: int
    task: SuctionToolTask
    scene: SuctionToolScene

    @property
    def taken(self) -> bool:
        """Whether an object stands where others must go before it, so that moving each object once is not enough."""
        order = ObjectOrder.of(self.scene.objects)
        moved: frozenset[str] = frozenset()
        while following := order.next(moved):
            moved = moved.union(following)
        return len(moved) < len(self.scene.objects)


@dataclass(frozen=True)
class RefusedLayout:
    """A start that the service refuses."""

    pile: Pile
    seed: int
    reason: str


def strewn(pile: Pile, seed: int) -> dict[str, Any]:
    """Return the body of the pile's task with every object anywhere in the region, turned any way about the vertical.

    Nothing keeps objects apart or off the place of the pile.
    """
    rng = np.random.default_rng(seed)
    body = task_body(pile.task)
    for each in body["objects"]:
        x, y, half = rng.uniform(*X), rng.uniform(*Y), 0.5 * rng.uniform(-np.pi, np.pi)
        each["pose"] = [x, y, each["pose"][2], float(np.cos(half)), 0.0, 0.0, float(np.sin(half))]
    return {**body, "external_id": f"{pile.task}_{seed}", "seed": seed}


def lay(pile: Pile, seed: int, cells: dict[str, Cell] | None = None) -> Layout | RefusedLayout:
    """Build the scene of a random start."""
    task = read_task(strewn(pile, seed))
    assert isinstance(task, SuctionToolTask)
    try:
        return Layout(pile, seed, task, build_tool_scene(task, cells))
    except SceneError as refusal:
        return RefusedLayout(pile, seed, refusal.detail)
