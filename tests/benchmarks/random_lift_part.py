"""The part of RESULTS.md on random plate lifts."""

from __future__ import annotations

from pathlib import Path

from tests.benchmarks import bench_random_lifts
from tests.benchmarks.attempt_file import kept_attempts
from tests.benchmarks.effort import Effort
from tests.benchmarks.part import Findings
from tests.benchmarks.random_lift_report import limits, sections
from tests.benchmarks.tasks import Note


def measure(effort: Effort, note: Note, _folder: Path) -> Findings:
    """Plan random lifts; what a stopped run had planned with the same code is not planned again."""
    with kept_attempts(effort.resumed) as kept:
        figures = bench_random_lifts.measure(note, kept, effort.random_lifts, effort.processes, effort.most_attempts)
    return Findings(limits(figures), sections(figures))
