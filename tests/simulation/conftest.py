"""One plan, executed and lifted once."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import Any

import pytest
from support.documents import simulated

from planners.contract.task_spec import read_task
from planners.planning import plan
from planners.progress import silent
from planners.scene.lift_scene import PlateLiftScene
from planners.scene.scene import build_scene

TASKS = Path(__file__).resolve().parents[2] / "assets" / "tasks"
SHORTEST = "pb1"
"""Of the papers' lifts."""


@dataclass(frozen=True, eq=False)
class Run:
    scene: PlateLiftScene
    document: dict[str, Any]
    simulation: dict[str, Any]
    stages: list[tuple[str, float]]


def execute(name: str = SHORTEST, **changes: Any) -> Run:
    """Plan a task of the papers with changes, and lift it."""
    task = read_task(json.loads((TASKS / f"{name}.json").read_text()) | changes)
    scene = build_scene(task)
    document = plan(task, scene, silent, perf_counter).document() | {"id": name}
    seen: list[tuple[str, float]] = []
    simulation = simulated(document, scene, lambda report: seen.append((report.stage, report.done / report.total)), 3)
    return Run(scene, document, simulation, seen)


@pytest.fixture(scope="session")
def run() -> Run:
    """With the paper's lifter."""
    return execute()


@pytest.fixture(scope="session")
def cable_run() -> Run:
    """With a cup on a cable."""
    return execute(lifter_model="cable")


@pytest.fixture(scope="session")
def scene(run: Run) -> PlateLiftScene:
    return run.scene
