"""The part of RESULTS.md on studies and remedies."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from planners.study.study_map import OUTCOMES, StudyPoint
from tests.benchmarks import bench_studies
from tests.benchmarks.bench_studies import MODELS, MapFigures, RemedySearch
from tests.benchmarks.effort import Effort
from tests.benchmarks.markdown import table
from tests.benchmarks.part import Findings, Limit
from tests.benchmarks.tasks import Note

MOST_SECONDS = 60.0
"""For 12 x 12 places of the cup on two cores [s]."""
MOST_REMEDY_SECONDS = 30.0
"""For nine of ten searches for remedies, on two cores [s]."""


def measure(effort: Effort, note: Note, _folder: Path) -> Findings:
    """Study the shipped lifts with all models of the lifter, and where the cup of AB1 may sit; ask what helps."""
    mapped = bench_studies.cup_map(effort.study_places, note)
    by_task = bench_studies.models(effort.solvable, note)
    limits = [Limit.at_most("map of cup places, all points [s]", {bench_studies.MAPPED: mapped.seconds}, MOST_SECONDS)]
    sections = [lifters(by_task), places(mapped)]
    if searches := bench_studies.remedies(effort.remedy_searches, note):
        slow = {"random lifts": float(np.quantile([each.seconds for each in searches], 0.9))}
        limits.append(Limit.at_most("remedies where there is no plan, nine of ten [s]", slow, MOST_REMEDY_SECONDS))
        sections.append(helps(searches))
    return Findings(limits, sections)


def lifters(by_task: Mapping[str, Sequence[StudyPoint]]) -> str:
    """Return the section on the models of the lifter."""
    head = ("task", *(f"{model}: {what}" for model in MODELS for what in ("outcome", "reserve [%]", "force [N]")))
    rows = [(name, *(cell for point in points for cell in _cells(point))) for name, points in by_task.items()]
    uncertified = sum(point.outcome == "solved" and not point.certified for row in by_task.values() for point in row)
    text = (
        "A study of each shipped lift over `lifter_model`, every point planned as a plan is, and certified: "
        f"{uncertified} solved points without a certificate that passed. `paper` and `cable` differ in whether the cup "
        "pulls across its cable; `dexnet` bears least across where it pulls most."
    )
    return f"### Three models of the lifter\n\n{text}\n\n{table(head, rows)}"


def _cells(point: StudyPoint) -> tuple[str, float | None, float | None]:
    reserve = None if point.reserve is None else 100.0 * point.reserve
    return point.outcome.replace("_", " "), reserve, point.largest_force


def places(figures: MapFigures) -> str:
    """Return the section on the map of cup places."""
    found = figures.found
    sides = " × ".join(str(len(axis.values)) for axis in found.axes)
    best = "none" if found.best is None else f"cup at {found.best.values} m: {found.best.why}"
    text = (
        f"`liftwright study` of {bench_studies.MAPPED} at {sides} places of the cup with {bench_studies.PROCESSES} "
        f"processes: {figures.seconds:.0f} s, their start included. A point takes {figures.shared:.2f} s of CPU time "
        f"with what is known of the reach from others, and {figures.alone:.2f} s without. Best: {best}."
    )
    return f"### Where the cup may sit\n\n{text}\n\n{table(OUTCOMES, [[found.outcomes[name] for name in OUTCOMES]])}"


def helps(searches: Sequence[RemedySearch]) -> str:
    """Return the section on remedies."""
    seconds = [each.seconds for each in searches]
    text = (
        "The first random lifts (part `lifts_random`) that have no plan, one at a time: how long looking for changes "
        f"of the task took that were planned and certified. The median is {np.median(seconds):.1f} s, the longest "
        f"{max(seconds):.1f} s."
    )
    rows = [(each.seed, each.found, each.seconds) for each in searches]
    return f"### What helps where there is no plan\n\n{text}\n\n{table(('seed', 'remedies', 'seconds'), rows)}"
