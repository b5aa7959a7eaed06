"""Tasks of every shipped cell, drawn at random around one that is shipped for it: planned and certified."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from itertools import count
from pathlib import Path
from typing import Any, Self

import numpy as np

from planners.cell.cell import Cell
from planners.contract.task_spec import PlateLiftTask, read_task
from planners.errors import SceneError
from planners.scene.scene import build_scene
from planners.scene.tool_scene import build_tool_scene
from tests.benchmarks.certified_plan import BROKEN, SOLVED, certified_plan
from tests.benchmarks.random_piles import strewn_about
from tests.benchmarks.tasks import task_body
from workers.solver.pipeline import Pipeline

EXAMPLES = {
    "dual_ur3e_lift": "ab1",
    "dual_ur3_lift": "ab1_ur3",
    "dual_ur10e_lift": "sheet_ur10e",
    "dual_ur3e_tool": "tissue_pile",
    "dual_ur3_tool": "tissue_pile_ur3",
    "dual_ur5e_tool": "carton_pile",
}
"""The task that others are drawn around, by cell."""
BESIDE = {"plate_lift": "dual_ur3e_lift", "suction_tool": "dual_ur3e_tool"}
"""The cell that others of a kind are compared with."""
SIDES, THICKNESS, MASS = (0.85, 1.15), (0.9, 1.3), (0.8, 1.05)
"""Of a plate, each side by itself, over those of the example [1]."""
SHIFT, YAW = 0.15, 20.0
"""How far a plate lies from where the example has it, as a share of its sides, and how far it is turned [degrees]."""
CUP_SHIFT = 0.12
"""How far the cup sits from where the example has it, as a share of the plate's sides."""
REACH = 0.5
"""Of the arms that the region for objects was made for [m]; with others it grows as their reach does."""
MOST_DRAWS = 1000


@dataclass(frozen=True)
class CellAttempt:
    """What came of one task. Seconds."""

    cell: str
    variant: str
    """The example."""
    seed: int
    outcome: str
    """As in the plan document, or that its certificate failed, or that the planner broke."""
    summary: str = ""
    """Why it is not solved and certified."""
    physics: str | None = None
    """How the plan fails in physics, "" where it does not; None where that was not tried."""
    refused: int = 0
    """Draws before it that the service refuses."""
    objects: int = 1
    """That are moved."""
    planning: float = 0.0
    """Spec to document, wall clock."""
    planning_cpu: float = 0.0
    certificate: float = 0.0
    certificate_cpu: float = 0.0

    @property
    def key(self) -> tuple[str, str, int]:
        """Cell, example and seed."""
        return self.cell, self.variant, self.seed

    @property
    def solved(self) -> bool:
        """Whether it was planned and the plan passed its certificate."""
        return self.outcome == SOLVED

    def told(self) -> str:
        """Say in a line what came of it."""
        said = f"fails in physics: {self.physics}" if self.physics else self.summary
        return f"{self.cell}, seed {self.seed}: {self.outcome} in {self.planning:.2f} s. {said}".strip()

    @classmethod
    def broken(cls, key: tuple[str, str, int], error: BaseException) -> Self:
        """Return the attempt at which the planner raised what it should not raise."""
        return cls(*key, BROKEN, f"{type(error).__name__}: {error}")


def attempt(databases: Path, simulated: int, cell: str, example: str, seed: int) -> CellAttempt:
    """Plan and certify the task of a seed in this process, whose kernels the first one loads.

    Args:
        databases: folder of a handover store.
        simulated: plans of so many seeds are also executed in physics, the first of them.
        cell: that the task is in.
        example: the shipped task that it is drawn around.
        seed: of the draw.
    """
    pipeline = _warm_pipeline(databases, example)
    body, refused = accepted(pipeline.solver.cells, cell, example, seed)
    plan = certified_plan(pipeline, body, simulate=seed < simulated)
    objects, summary = len(body.get("objects", "1")), plan.document["explanation"]["summary"]
    told = "" if plan.outcome == SOLVED else summary or plan.reason
    physics = None
    if seed < simulated and plan.outcome == SOLVED:
        physics = "" if plan.failure is None else plan.failure.words()
    return CellAttempt(cell, example, seed, plan.outcome, told, physics, refused, objects, **plan.seconds)


def accepted(cells: Mapping[str, Cell], cell: str, example: str, seed: int) -> tuple[dict[str, Any], int]:
    """Return the first draw of a seed that the service accepts, and how many before it are refused."""
    rng, shipped = np.random.default_rng(seed), task_body(example)
    reach = max(arm.robot.reach for arm in cells[cell].arms.values())
    for refused in count():
        if shipped["kind"] == "plate_lift":
            body = _lift(rng, shipped)
        else:
            body = strewn_about(shipped, rng, reach / REACH)
        body = {**body, "cell": cell, "external_id": f"{example}_{seed}", "seed": seed}
        if _is_accepted(body, cells):
            return body, refused
        assert refused < MOST_DRAWS, f"hardly any draw around {example} is accepted"
    raise AssertionError


def _is_accepted(body: Mapping[str, Any], cells: Mapping[str, Cell]) -> bool:
    task = read_task(dict(body))
    try:
        if isinstance(task, PlateLiftTask):
            build_scene(task, cells)
        else:
            build_tool_scene(task, cells)
    except SceneError:
        return False
    return True


def _lift(rng: np.random.Generator, shipped: dict[str, Any]) -> dict[str, Any]:
    """Draw another plate, where it and what it rests on are, and where the cup sits."""
    size = np.array(shipped["plate"]["shape"]["size"])
    drawn = np.round(size * [*rng.uniform(*SIDES, 2), rng.uniform(*THICKNESS)], 4)
    mass = round(shipped["plate"]["mass"] * rng.uniform(*MASS), 3)
    cup = (
        np.array(shipped["cup"]["position"]) * drawn[:2] / size[:2] + rng.uniform(-CUP_SHIFT, CUP_SHIFT, 2) * drawn[:2]
    )
    where = np.array(shipped["plate_pose"][:3])
    x, y = where[:2] + rng.uniform(-SHIFT, SHIFT, 2) * drawn[:2]
    bottom, half = where[2] - 0.5 * size[2], 0.5 * np.radians(rng.uniform(-YAW, YAW))
    turned = [float(np.cos(half)), 0.0, 0.0, float(np.sin(half))]
    body = {
        **shipped,
        "plate": {"shape": {"type": "box", "size": drawn.tolist()}, "mass": mass},
        "plate_pose": [float(x), float(y), float(bottom + 0.5 * drawn[2]), *turned],
        "cup": {**shipped["cup"], "position": np.round(cup, 4).tolist()},
    }
    if "support" in shipped:
        board = shipped["support"]
        scaled = [*drawn[:2].tolist(), board["shape"]["size"][2]]
        pose = [float(x), float(y), board["pose"][2], *turned]
        body["support"] = {"shape": {"type": "box", "size": scaled}, "pose": pose}
    return body


@cache
def _pipeline(databases: Path) -> Pipeline:
    return Pipeline.load(databases)


@cache
def _warm_pipeline(databases: Path, example: str) -> Pipeline:
    """Return this process's pipeline with all kernels loaded that an example needs, and its handovers known."""
    pipeline = _pipeline(databases)
    certified_plan(pipeline, task_body(example))
    return pipeline
