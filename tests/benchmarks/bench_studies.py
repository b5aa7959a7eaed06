"""Measure studies and remedies: models of the lifter side by side, a map of cup places, what helps unsolved lifts."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from tempfile import TemporaryDirectory

from planners.progress import silent
from planners.study.examine import PointExaminer
from planners.study.study import Study
from planners.study.study_map import StudyMap, StudyPoint
from tests.benchmarks.machine import ROOT
from tests.benchmarks.random_lifts import drawn, refusal
from tests.benchmarks.tasks import Note, cpu_seconds, task_body, timed
from workers.solver.pipeline import Pipeline
from workers.solver.protocol import SolverRequest

MODELS = ("paper", "cable", "dexnet")
MAPPED = "ab1"
PLACES = 12
"""Of the cup along each of the plate's axes."""
EDGE = 0.12
"""The outermost ones, from the middle [m]."""
PROCESSES = 2
SAMPLE = 12
"""Points of the map that are examined once more as if nothing was known of others."""


@dataclass(frozen=True)
class MapFigures:
    """What a map of cup places cost."""

    found: StudyMap
    seconds: float
    """Until it was printed, start of the processes included [s]."""
    shared: float
    """CPU time of a point with what is known of others [s]."""
    alone: float
    """Without [s]."""


def models(tasks: Sequence[str], note: Note) -> dict[str, list[StudyPoint]]:
    """Return what each model's points say, each planned and certified, by the task."""
    examiner = PointExaminer(Pipeline.load().warm_up().solver)
    found: dict[str, list[StudyPoint]] = {}
    for name in tasks:
        axis = {"pointer": "/lifter_model", "values": list(MODELS)}
        study = Study.read({"task": task_body(name), "axes": [axis], "certify": True})
        found[name] = [examiner.examine(study, index) for index in range(study.count)]
        note(f"studies: {name} with all lifters")
    return found


def cup_map(places: int, note: Note) -> MapFigures:
    """Return the map of cup places of AB1, as anybody gets it from the command line."""
    axes = [f"--axis=/cup/position/{axis}={-EDGE}:{EDGE}:{places}" for axis in (0, 1)]
    task = ROOT / "assets" / "tasks" / f"{MAPPED}.json"
    with TemporaryDirectory() as folder:
        out = Path(folder) / "map.json"
        words = [sys.executable, "-m", "app.cli.main", "study", str(task), *axes, "--out", str(out)]
        command = [*words, "--processes", str(PROCESSES)]
        _, seconds = timed(lambda: subprocess.run(command, cwd=ROOT, check=True, capture_output=True))
        found = StudyMap.model_validate_json(out.read_bytes())
    note("studies: map of cup places")
    study = Study.read({"task": found.task, "axes": [axis.model_dump() for axis in found.axes]})
    sample = range(0, study.count, max(1, study.count // SAMPLE))
    solver = Pipeline.load().warm_up().solver
    one = PointExaminer(solver)
    one.examine(study, sample[0])
    shared = cpu_seconds(lambda: [one.examine(study, index) for index in sample])
    alone = cpu_seconds(lambda: [PointExaminer(solver).examine(study, index) for index in sample])
    note("studies: points one by one")
    return MapFigures(found, seconds, shared / len(sample), alone / len(sample))


@dataclass(frozen=True)
class RemedySearch:
    """What looking for remedies of one lift came to."""

    seed: int
    found: int
    """Changes of the task that were planned and certified."""
    seconds: float
    """Wall clock, on a machine that does nothing else [s]."""


def remedies(lifts: int, note: Note) -> list[RemedySearch]:
    """Look for what helps with so many random lifts that have no plan, one after the other."""
    pipeline = Pipeline.load().warm_up()
    searches: list[RemedySearch] = []
    for seed in count():
        if len(searches) >= lifts:
            return searches
        if refusal(seed, pipeline.solver.cells) is None:
            body = {**drawn(seed), "options": {"simulate": False}}
            plan = pipeline.solve(SolverRequest("benchmark", body), silent)
            if plan.outcome != "solved":
                seconds = dict(plan.statistics.times)["remedies"]
                searches.append(RemedySearch(seed, len(plan.explanation.remedies or ()), seconds))
                note(f"studies: remedies of seed {seed}")
    raise AssertionError
