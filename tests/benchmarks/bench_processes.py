"""What a process costs: from a cold interpreter to ready, and the peak memory of planning; and how both grow."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import median
from typing import Any

from tests.benchmarks.machine import ROOT
from tests.benchmarks.tasks import SOLVABLE, TOO_HEAVY, Note, task_body, timed
from workers.settings import SOLVER_COMMAND

DENSITIES = ((1, 1), (2, 1), (1, 2), (2, 2))
"""Of contacts and of holds."""


@dataclass(frozen=True)
class ProcessFigures:
    """One task planned in a process of its own, which had planned the reference task before; seconds."""

    name: str
    contact_density: float
    hold_density: float
    outcome: str
    poses: int
    nodes: int
    edges: int
    planning: float
    planning_cpu: float
    peak_mib: float


def measure_start(note: Note, runs: int = 3) -> float:
    """Return the median seconds from a cold interpreter to a solver process that is ready, kernels cached."""
    note("starting solver processes")
    return median(timed(_until_ready)[1] for _ in range(runs))


def measure(note: Note, names: Sequence[str] = (*SOLVABLE, *TOO_HEAVY)) -> list[ProcessFigures]:
    """Plan each task in a process of its own."""
    return [_process(name, 1, 1, note) for name in names]


def measure_scaling(
    note: Note, names: Sequence[str] = ("ab1", "pb1"), densities: Sequence[tuple[float, float]] = DENSITIES
) -> list[ProcessFigures]:
    """Plan with more contacts and more holds."""
    return [_process(name, *density, note) for name in names for density in densities]


def _until_ready() -> None:
    """Start a solver process as the worker does, and wait for its word; with stdin closed it ends."""
    with subprocess.Popen(SOLVER_COMMAND, cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as solver:
        assert solver.stdin is not None
        assert solver.stdout is not None
        message = json.loads(solver.stdout.readline())
        solver.stdin.close()
    if not message.get("ready"):
        raise RuntimeError(f"a solver process did not get ready: {message}")


def _process(name: str, contact_density: float, hold_density: float, note: Note) -> ProcessFigures:
    note(f"planning {name} in a process of its own, contacts ×{contact_density}, holds ×{hold_density}")
    body = task_body(name, contact_density=float(contact_density), hold_density=float(hold_density))
    words = [sys.executable, "-m", "tests.benchmarks.planning_process"]
    done = subprocess.run(words, cwd=ROOT, input=json.dumps(body), stdout=subprocess.PIPE, text=True, check=True)
    told: dict[str, Any] = json.loads(done.stdout)
    return ProcessFigures(
        name, contact_density, hold_density, told["outcome"], told["poses"], told["nodes"], told["edges"],
        told["planning"], told["planning_cpu"], told["peak_mib"],
    )  # fmt: skip
