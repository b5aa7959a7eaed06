"""The shipped tasks, and one way to time them."""

from __future__ import annotations

import json
from collections.abc import Callable
from statistics import median
from time import perf_counter, process_time
from typing import Any, TypeVar

from planners.contract.task_spec import PlateLiftTask, read_task
from planners.manipulation.planner import PlateLiftPlanner
from planners.planning import lift_settings
from planners.progress import silent
from planners.scene.scene import build_scene
from tests.benchmarks.machine import ROOT

SOLVABLE = ("ab1", "ab2", "ab3", "pb1", "pb2")
TOO_HEAVY = ("pb1_weak_cup", "pb2_weak_cup")

Result = TypeVar("Result")
Note = Callable[[str], None]
"""Told what is being measured."""


def task_body(name: str, **options: Any) -> dict[str, Any]:
    """Return the body of a shipped task, with options set."""
    body = json.loads((ROOT / "assets" / "tasks" / f"{name}.json").read_text())
    if options:
        body["options"] = {**body.get("options", {}), **options}
    return body


def planner_of(name: str, **options: Any) -> PlateLiftPlanner:
    """Return a planner that has sampled poses and holds, and nothing more."""
    task = read_task(task_body(name, **options))
    assert isinstance(task, PlateLiftTask)
    return PlateLiftPlanner(build_scene(task), lift_settings(task.options), silent)


def timed(work: Callable[[], Result], clock: Callable[[], float] = perf_counter) -> tuple[Result, float]:
    """Return a result and the seconds it took."""
    begun = clock()
    result = work()
    return result, clock() - begun


def cpu_seconds(work: Callable[[], object]) -> float:
    """Return the CPU time of this process that something took [s]: other load hardly changes it."""
    return timed(work, process_time)[1]


def median_of(rows: list[dict[str, float]]) -> dict[str, float]:
    """Return the median of each member that all rows have."""
    return {name: median(row[name] for row in rows) for name in rows[0] if all(name in row for row in rows)}
