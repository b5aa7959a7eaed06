"""One plan, executed and lifted once."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import pytest

from planners.contract.task_spec import read_task
from planners.plan.plan import Plan
from planners.plan.segment import Segment
from planners.plan.simulation import LiftSimulation
from planners.scene.lift_scene import PlateLiftScene
from planners.scene.scene import build_scene
from tests.support.plan_shelf import PlanShelf
from tests.support.service import task
from workers.simulation.simulate import simulate_lift

SHORTEST = "pb1"
"""Of the papers' lifts."""


@dataclass(frozen=True, eq=False)
class Run:
    scene: PlateLiftScene
    plan: Plan
    simulation: LiftSimulation
    stages: list[tuple[str, float]]


def execute(shelf: PlanShelf, name: str = SHORTEST, **changes: Any) -> Run:
    """Lift a task of the papers with changes."""
    read = read_task(task(f"{name}.json", **changes))
    scene = build_scene(read)
    assert isinstance(scene, PlateLiftScene)
    found = shelf.plan(read).model_copy(update={"simulation": None})
    seen: list[tuple[str, float]] = []
    simulation = simulate_lift(found, scene, lambda report: seen.append((report.stage, report.done / report.total)), 3)
    return Run(scene, found, simulation, seen)


def tampered(found: Plan, change: Callable[[int, Segment], dict[str, Any]]) -> Plan:
    """Return a plan with other members in its segments: those that `change` returns for each, by its number."""
    segments = [each.model_copy(update=change(index, each)) for index, each in enumerate(found.segments)]
    return found.model_copy(update={"segments": segments})


def squeezing(found: Plan, force: float | None) -> Plan:
    """Return a plan whose grips command another squeeze [N]."""

    def change(_: int, segment: Segment) -> dict[str, Any]:
        if segment.hold is None or segment.hold.grip is None:
            return {}
        grip = segment.hold.grip.model_copy(update={"squeeze": force})
        return {"hold": segment.hold.model_copy(update={"grip": grip})}

    return tampered(found, change)


@pytest.fixture(scope="session")
def run(shelf: PlanShelf) -> Run:
    """With the paper's lifter."""
    return execute(shelf)


@pytest.fixture(scope="session")
def cable_run(shelf: PlanShelf) -> Run:
    """With a cup on a cable."""
    return execute(shelf, lifter_model="cable", options={"simulate": False})


@pytest.fixture(scope="session")
def scene(run: Run) -> PlateLiftScene:
    return run.scene
