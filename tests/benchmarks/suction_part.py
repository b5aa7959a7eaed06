"""The part of RESULTS.md on the suction tool: random layouts, paper A's tables, and the quality of motion."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from tests.benchmarks import bench_handovers, bench_piles, bench_tool_motion
from tests.benchmarks.attempt_file import kept_attempts
from tests.benchmarks.effort import Effort
from tests.benchmarks.part import Findings
from tests.benchmarks.suction_plots import draw_planning
from tests.benchmarks.suction_report import PLANNING_AIM, PLANNING_LIMIT, limits, sections
from tests.benchmarks.tasks import Note


@dataclass(frozen=True)
class SuctionFigures:
    """All that was measured of the suction tool."""

    handovers: list[bench_handovers.HandoverFigures]
    piles: list[bench_piles.PileFigures]
    motion: list[bench_tool_motion.TaskMotion]


def measure(effort: Effort, note: Note, folder: Path) -> Findings:
    """Measure the suction tool; what a stopped run had planned with the same code is not planned again."""
    with kept_attempts(effort.resumed) as kept:
        figures = SuctionFigures(
            bench_handovers.measure(note, kept, effort.handover_tasks),
            bench_piles.measure(note, kept, effort.piles, effort.layouts),
            bench_tool_motion.measure(note, kept, effort.tool_tasks),
        )
    picture = draw_planning(figures.piles, PLANNING_LIMIT, PLANNING_AIM, folder)
    return Findings(limits(figures), sections(figures, picture))
