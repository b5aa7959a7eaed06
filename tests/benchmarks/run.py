"""Runs all benchmarks and gathers what they measured."""

from __future__ import annotations

from dataclasses import dataclass

from tests.benchmarks import (
    bench_balance,
    bench_collision,
    bench_graph,
    bench_kinematics,
    bench_motion,
    bench_paper_method,
    bench_processes,
    bench_search,
    bench_service,
    bench_simulation,
    bench_tasks,
)
from tests.benchmarks.machine import describe_run, load
from tests.benchmarks.tasks import SOLVABLE, TOO_HEAVY, Note
from workers.pipeline import Pipeline

KERNELS = {
    "collision": bench_collision.measure,
    "kinematics": bench_kinematics.measure,
    "balance": bench_balance.measure,
    "motion": bench_motion.measure,
    "search": bench_search.measure,
}
PAUSE_PER_START = 2.0
"""Pause between jobs, in times of a solver's start: the next solver has to be ready, on a loaded machine too."""


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


FULL = Effort()
QUICK = Effort(
    tasks=("ab1",), solvable=("ab1",), runs=1, paper_sample=20, paper_programs=4, scaled=(), densities=(),
    kernels=("kinematics",), service=False, lifters=1,
)  # fmt: skip
"""Only shows that everything works; its figures mean nothing."""


@dataclass(frozen=True)
class Results:
    """All that was measured."""

    machine: dict[str, str]
    tasks: list[bench_tasks.TaskFigures]
    start: float
    """From a cold interpreter to a solver that is ready [s]."""
    processes: list[bench_processes.ProcessFigures]
    service: bench_service.ServiceFigures | None
    graphs: list[bench_graph.GraphFigures]
    searches: list[bench_graph.SearchFigures]
    paper_method: list[bench_paper_method.PaperMethodFigures]
    scaling: list[bench_processes.ProcessFigures]
    kernels: dict[str, dict[str, float]]
    simulations: list[bench_simulation.SimulationFigures]


def run(effort: Effort, note: Note) -> Results:
    """Measure everything, one after the other."""
    machine = describe_run()
    tasks = bench_tasks.measure(Pipeline.load(), note, effort.tasks, effort.runs)
    start = bench_processes.measure_start(note, min(3, effort.runs))
    processes = bench_processes.measure(note, effort.tasks)
    service = bench_service.measure(note, PAUSE_PER_START * start, effort.tasks) if effort.service else None
    graphs, searches = bench_graph.measure(note, effort.solvable)
    paper_method = bench_paper_method.measure(note, effort.solvable, effort.paper_sample, effort.paper_programs)
    scaling = bench_processes.measure_scaling(note, effort.scaled, effort.densities)
    kernels = {name: _kernel(name, note) for name in effort.kernels}
    simulations = bench_simulation.measure(note, effort.solvable, effort.lifters)
    machine["load when done"] = load()
    return Results(
        machine, tasks, start, processes, service, graphs, searches, paper_method, scaling, kernels, simulations,
    )  # fmt: skip


def _kernel(name: str, note: Note) -> dict[str, float]:
    note(f"kernels: {name}")
    return KERNELS[name]()
