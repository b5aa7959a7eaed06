"""The part of RESULTS.md on the shipped cells: how many random tasks are solved, how fast, and what physics says."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from statistics import median

import numpy as np

from tests.benchmarks.attempt_file import AttemptFile, kept_attempts, repeated
from tests.benchmarks.cell_tasks import BESIDE, EXAMPLES, CellAttempt, attempt
from tests.benchmarks.effort import Effort
from tests.benchmarks.markdown import Cell, table
from tests.benchmarks.part import Findings, Limit
from tests.benchmarks.random_lift_report import share, without_figures
from tests.benchmarks.tasks import Note, task_body

SLOWER = 2.0
"""The median of planning may be so many times that of the UR3e cell [1]."""
ANSWERS = ("solved", "infeasible", "not_found")
_MEASURING = ("cell_tasks.py", "random_piles.py", "certified_plan.py")


@dataclass(frozen=True)
class CellFigures:
    """All tasks of one cell."""

    cell: str
    attempts: Sequence[CellAttempt]
    """By seed."""

    @property
    def kind(self) -> str:
        """Of its tasks."""
        return task_body(EXAMPLES[self.cell])["kind"]

    @property
    def planning(self) -> list[float]:
        """CPU from spec to document over the number of objects, of each attempt [s]."""
        return [each.planning_cpu / each.objects for each in self.attempts]

    def ended(self, *outcomes: str) -> list[CellAttempt]:
        """Return the attempts that ended so."""
        return [each for each in self.attempts if each.outcome in outcomes]


def measure(effort: Effort, note: Note, _folder: Path) -> Findings:
    """Plan random tasks in every cell; what a stopped run had planned with the same code is not planned again."""
    with kept_attempts(effort.resumed) as kept:
        file = AttemptFile.of_this_code(kept, CellAttempt, "cells", _MEASURING)
        cases = [(cell, EXAMPLES[cell]) for cell in effort.cells]
        told = partial(_told, note)
        found = repeated(
            file, partial(attempt, kept, effort.cell_simulations), cases, effort.cell_tasks, effort.processes, told,
            effort.most_attempts,
        )  # fmt: skip
    figures = [CellFigures(cell, attempts) for (cell, _), attempts in zip(cases, found, strict=True)]
    return Findings(_limits(figures), [_outcomes(figures), _reasons(figures), _physics(figures)])


def _told(note: Note, words: str) -> None:
    note(f"cells: {words}")


def _limits(figures: Sequence[CellFigures]) -> list[Limit]:
    broken = sum(len(each.attempts) - len(each.ended(*ANSWERS)) for each in figures)
    ratios = {each.cell: ratio for each in figures if (ratio := _ratio(each, figures)) is not None}
    return [
        Limit("tasks that fail their certificate or end with an error", "0", broken, broken == 0),
        *([Limit.at_most("planning over that in the UR3e's cell, medians of CPU", ratios, SLOWER)] if ratios else []),
    ]


def _ratio(cell: CellFigures, figures: Sequence[CellFigures]) -> float | None:
    """Return how many times as long planning takes as in the UR3e's cell; None for that one and if it is missing."""
    beside = next((each for each in figures if each.cell == BESIDE[cell.kind]), None)
    if beside is None or beside is cell:
        return None
    return median(cell.planning) / median(beside.planning)


def _outcomes(figures: Sequence[CellFigures]) -> str:
    return "\n\n".join(
        [
            "### Random tasks by cell",
            "Drawn by seed around a shipped task of the cell: other plates, places, yaws, masses and cup places, or "
            "objects strewn over as much of the table as the arms reach; `tests/benchmarks/cell_tasks.py` says from "
            "what. Draws that the service refuses are drawn again. Nothing is known beforehand about whether a task "
            "can be solved.",
            table(
                ("cell", "around", "refused draws", "planned", "solved and certified", "infeasible", "not found",
                 "neither"),
                [list(_shares(each)) for each in figures],
            ),
            "Seconds of CPU, kernels and handovers loaded: planning from the parsed body to the finished document, an "
            "object of a pile or a lift; the certificate of a whole task.",
            table(
                ("cell", "planning, median", "90 %", "most", "median over that of the UR3e", "certificate, median",
                 "most"),
                [list(_seconds(each, figures)) for each in figures],
            ),
        ]
    )  # fmt: skip


def _shares(cell: CellFigures) -> Iterator[Cell]:
    planned = len(cell.attempts)
    yield from (cell.cell, EXAMPLES[cell.cell], sum(each.refused for each in cell.attempts), planned)
    counts = [len(cell.ended(outcome)) for outcome in ANSWERS]
    yield from (share(each, planned) for each in (*counts, planned - sum(counts)))


def _seconds(cell: CellFigures, figures: Sequence[CellFigures]) -> Iterator[Cell]:
    certificates = [each.certificate_cpu for each in cell.attempts]
    yield cell.cell
    yield from (median(cell.planning), float(np.percentile(cell.planning, 90)), max(cell.planning))
    yield from (_ratio(cell, figures), median(certificates), max(certificates))


def _reasons(figures: Sequence[CellFigures]) -> str:
    reasons = Counter(
        (each.cell, each.outcome.replace("_", " "), _without_figures(each.summary))
        for cell in figures for each in cell.attempts if not each.solved
    )  # fmt: skip
    head = "### Tasks of cells that are not solved"
    if not reasons:
        return f"{head}\n\nAll are solved."
    rows = [[cell, outcome, why, count] for (cell, outcome, why), count in reasons.most_common()]
    return f"{head}\n\n" + table(("cell", "ended as", "why", "tasks"), rows)


def _physics(figures: Sequence[CellFigures]) -> str:
    """Tell how many plans are carried out in physics, which certificates know nothing of, and how the others fail."""
    tried = {each.cell: [plan for plan in each.attempts if plan.physics is not None] for each in figures}
    shares = [
        [cell, len(plans), share(sum(not plan.physics for plan in plans), len(plans))]
        for cell, plans in tried.items() if plans
    ]  # fmt: skip
    failed = [[plan.cell, plan.seed, plan.physics] for plans in tried.values() for plan in plans if plan.physics]
    parts = [
        "### Plans of random tasks in physics",
        "Certified plans of the first seeds, executed with what neither plan nor certificate knows: a sensor's noise, "
        "a lifter whose force is off, contacts that slip.",
        table(("cell", "plans", "carried out"), shares),
    ]
    if failed:
        parts.append(table(("cell", "seed", "how it fails"), failed))
    return "\n\n".join(parts)


def _without_figures(summary: str) -> str:
    """Leave numbers and which edge or object it is out, so that equal reasons are counted together."""
    return without_figures(re.sub(r"_\d+\b", "", summary))
