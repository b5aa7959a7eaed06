"""The part of RESULTS.md on simulated lifts."""

from __future__ import annotations

from pathlib import Path

from tests.benchmarks import bench_simulation
from tests.benchmarks.effort import Effort
from tests.benchmarks.lift_plots import draw_lift
from tests.benchmarks.lift_report import lift_limits, lift_sections
from tests.benchmarks.part import Findings
from tests.benchmarks.tasks import Note


def measure(effort: Effort, note: Note, folder: Path) -> Findings:
    """Simulate the plans of all tasks behind random lifters."""
    figures = bench_simulation.measure(note, effort.solvable, effort.lifters)
    pictures = {each.task: file for each in figures if (file := draw_lift(each, folder))}
    return Findings(list(lift_limits(figures)), lift_sections(figures, pictures))
