"""The part of RESULTS.md on what a reserve is worth."""

from __future__ import annotations

from pathlib import Path

from tests.benchmarks import bench_reserve
from tests.benchmarks.attempt_file import kept_attempts
from tests.benchmarks.effort import Effort
from tests.benchmarks.part import Findings
from tests.benchmarks.reserve_report import limits, sections
from tests.benchmarks.tasks import Note


def measure(effort: Effort, note: Note, _folder: Path) -> Findings:
    """Execute plans where things differ from them; what a stopped run had done with the same code is not done again."""
    with kept_attempts(effort.resumed) as kept:
        figures = bench_reserve.measure(
            note, kept, effort.solvable, effort.reserve_runs, effort.processes, effort.most_attempts
        )
    return Findings(limits(figures), sections(figures))
