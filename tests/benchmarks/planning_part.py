"""The part of RESULTS.md on planning plate lifts: our tasks, the service, paper B's tables, its method, growth."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from tests.benchmarks import bench_graph, bench_paper_method, bench_processes, bench_service, bench_tasks
from tests.benchmarks.effort import Effort
from tests.benchmarks.part import Findings
from tests.benchmarks.planning_plots import draw
from tests.benchmarks.planning_report import limits, sections
from tests.benchmarks.tasks import Note
from workers.solver.pipeline import Pipeline

PAUSE_PER_START = 2.0
"""Pause between jobs, in times of a solver's start: the next solver has to be ready, on a loaded machine too."""


@dataclass(frozen=True)
class PlanningFigures:
    """All that was measured of planning plate lifts."""

    tasks: list[bench_tasks.TaskFigures]
    start: float
    """From a cold interpreter to a solver that is ready [s]."""
    processes: list[bench_processes.ProcessFigures]
    service: bench_service.ServiceFigures | None
    graphs: list[bench_graph.GraphFigures]
    searches: list[bench_graph.SearchFigures]
    paper_method: list[bench_paper_method.PaperMethodFigures]
    scaling: list[bench_processes.ProcessFigures]


def measure(effort: Effort, note: Note, folder: Path) -> Findings:
    """Measure planning, one thing after the other."""
    tasks = bench_tasks.measure(Pipeline.load(), note, effort.tasks, effort.runs)
    start = bench_processes.measure_start(note, min(3, effort.runs))
    processes = bench_processes.measure(note, effort.tasks)
    service = bench_service.measure(note, PAUSE_PER_START * start, effort.tasks) if effort.service else None
    graphs, searches = bench_graph.measure(note, effort.solvable, effort.variants)
    paper_method = bench_paper_method.measure(note, effort.solvable, effort.paper_sample, effort.paper_programs)
    scaling = bench_processes.measure_scaling(note, effort.scaled, effort.densities)
    figures = PlanningFigures(tasks, start, processes, service, graphs, searches, paper_method, scaling)
    return Findings(limits(figures), sections(figures, draw(figures, folder)))
