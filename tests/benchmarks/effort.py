"""How much the benchmarks measure."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from tests.benchmarks import (
    bench_balance,
    bench_collision,
    bench_kinematics,
    bench_motion,
    bench_processes,
    bench_search,
    bench_simulation,
)
from tests.benchmarks.tasks import SOLVABLE, TOO_HEAVY

KERNELS: dict[str, Callable[[], dict[str, float]]] = {
    "collision": bench_collision.measure,
    "kinematics": bench_kinematics.measure,
    "balance": bench_balance.measure,
    "motion": bench_motion.measure,
    "search": bench_search.measure,
}


@dataclass(frozen=True)
class Effort:
    """How much is measured."""

    tasks: tuple[str, ...] = (*SOLVABLE, *TOO_HEAVY)
    solvable: tuple[str, ...] = SOLVABLE
    runs: int = 5
    paper_sample: int = 400
    paper_programs: int = 60
    scaled: tuple[str, ...] = ("ab1", "pb1")
    densities: tuple[tuple[float, float], ...] = bench_processes.DENSITIES
    kernels: tuple[str, ...] = tuple(KERNELS)
    service: bool = True
    lifters: int = bench_simulation.LIFTERS
    frames: int = 200


FULL = Effort()
QUICK = Effort(
    tasks=("ab1",), solvable=("ab1",), runs=1, paper_sample=20, paper_programs=4, scaled=(), densities=(),
    kernels=("kinematics",), service=False, lifters=1, frames=5,
)  # fmt: skip
"""Only shows that everything works; its figures mean nothing."""
