"""The part of RESULTS.md on lifters of all speeds."""

from __future__ import annotations

from pathlib import Path

from tests.benchmarks import bench_lifters
from tests.benchmarks.attempt_file import kept_attempts
from tests.benchmarks.effort import Effort
from tests.benchmarks.lifter_report import limits, sections
from tests.benchmarks.part import Findings
from tests.benchmarks.tasks import Note


def measure(effort: Effort, note: Note, _folder: Path) -> Findings:
    """Lift behind lifters of all speeds; what a stopped run had done with the same code is not done again."""
    with kept_attempts(effort.resumed) as kept:
        figures = bench_lifters.measure(
            note, kept, effort.solvable, effort.lifters, effort.processes, effort.most_attempts
        )
    return Findings(limits(figures), sections(figures))
