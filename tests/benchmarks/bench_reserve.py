"""What a reserve is worth: plans that keep more or less of their limits back, executed where things differ."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import cache
from multiprocessing import get_context
from pathlib import Path
from time import process_time
from typing import Self

from planners.contract.task_spec import PlateLiftTask, read_task
from planners.plan.plan import Plan
from planners.planning import plan
from planners.progress import silent
from planners.scene.scene import build_scene
from tests.benchmarks.attempt_file import AttemptFile, repeated
from tests.benchmarks.certified_plan import BROKEN
from tests.benchmarks.reserve_draws import Deviation
from tests.benchmarks.tasks import SOLVABLE, Note, task_body
from workers.simulation.simulate import simulate_lift

RUNS = 100
RESERVES = (0.0, 0.1, 0.2)
"""Shares of every limit of force that plans are to keep back [1]."""
PROCESSES = 2
LIFTED, NO_PLAN = "lifted", "no plan"
_MEASURING = ("bench_reserve.py", "reserve_draws.py")


@dataclass(frozen=True)
class ReserveRun:
    """One plan executed once where things differ from its task."""

    task: str
    reserve: float
    """That was asked for [1]."""
    seed: int
    outcome: str
    """Of the simulation; or that there is no plan, or that something broke."""
    cause: str = ""
    """What gave way, or why there is none."""
    multiple: int = 0
    """Of the tolerances that the run was drawn from."""
    kept: float | None = None
    """Share that the plan keeps back, where its document says so [1]."""
    seconds: float = 0.0
    """CPU time of the simulation."""

    @classmethod
    def broken(cls, key: tuple[str, float, int], error: BaseException) -> Self:
        """Return the run that raised what it should not raise."""
        return cls(*key, BROKEN, f"{type(error).__name__}: {error}", Deviation.drawn(key[2]).multiple)

    @property
    def key(self) -> tuple[str, float, int]:
        """Task, reserve and seed."""
        return self.task, self.reserve, self.seed

    @property
    def lifted(self) -> bool:
        """Whether the plate was lifted."""
        return self.outcome == LIFTED

    def told(self) -> str:
        """Say in a line what came of it."""
        where = f"{self.task}, reserve {self.reserve:g}, seed {self.seed} ({self.multiple} × tolerance)"
        return f"{where}: {self.outcome}. {self.cause}".strip()


@dataclass(frozen=True)
class ReserveFigures:
    """All runs of one task with one reserve."""

    task: str
    reserve: float
    """That was asked for [1]."""
    runs: Sequence[ReserveRun]
    """By seed."""

    @property
    def kept(self) -> float | None:
        """Share that the plan keeps back [1], None where it does not say."""
        return next((run.kept for run in self.runs if run.kept is not None), None)

    @property
    def outcomes(self) -> Counter[str]:
        """How often what came of it."""
        return Counter(run.outcome for run in self.runs)

    def drawn_from(self, multiple: int) -> list[ReserveRun]:
        """Return the runs that were drawn from so many times the tolerances."""
        return [run for run in self.runs if run.multiple == multiple]


def measure(
    note: Note,
    kept: Path,
    tasks: Sequence[str] = SOLVABLE,
    runs: int = RUNS,
    processes: int = PROCESSES,
    most: int | None = None,
) -> list[ReserveFigures]:
    """Execute the plan of each task with each reserve so many times.

    Args:
        note: told of each that is done.
        kept: folder of runs, which are not repeated while the code is the same; more of them are added to it.
        tasks: shipped ones.
        runs: of each task and reserve, seeds from 0.
        processes: at a time.
        most: how many runs to make before this one stops; None: all.

    Raises:
        Unfinished: more than `most` are missing.
    """
    file = AttemptFile.of_this_code(kept, ReserveRun, "reserve", _MEASURING)
    first = _first_of_each_plan([(task, reserve) for task in tasks for reserve in RESERVES], processes)
    cases = list(dict.fromkeys(first.values()))
    done = repeated(file, _run, cases, runs, processes, lambda told: note(f"reserve: {told}"), most)
    by_case = dict(zip(cases, done, strict=True))
    return [
        ReserveFigures(task, reserve, [replace(run, reserve=reserve) for run in by_case[first[task, reserve]]])
        for task, reserve in first
    ]


def _first_of_each_plan(
    cases: Sequence[tuple[str, float]], processes: int
) -> dict[tuple[str, float], tuple[str, float]]:
    """Return for each case the first one of the same plan: executed alike, it need not be executed again."""
    with ProcessPoolExecutor(processes, mp_context=get_context("spawn")) as executor:
        plans = dict(zip(cases, executor.map(_motion, *zip(*cases, strict=True)), strict=True))
    first: dict[tuple[str, str], tuple[str, float]] = {}
    return {case: first.setdefault((case[0], plans[case]), case) for case in cases}


def _motion(name: str, reserve: float) -> str:
    """Return a digest of all that a plan has executed; of why there is none, where there is none."""
    plan = _planned(name, reserve)[1]
    told = plan.model_dump_json(include={"outcome", "segments"})
    return hashlib.sha256(told.encode()).hexdigest()


def _run(name: str, reserve: float, seed: int) -> ReserveRun:
    task, found = _planned(name, reserve)
    deviation = Deviation.drawn(seed)
    if found.outcome != "solved":
        return ReserveRun(name, reserve, seed, NO_PLAN, found.explanation.summary, deviation.multiple)
    scene, actual = build_scene(task), build_scene(deviation.actual(task))
    begun = process_time()
    simulation = simulate_lift(found, scene, silent, seed, deviation.settings(), actual)
    told = found.statistics.reserve
    return ReserveRun(
        name,
        reserve,
        seed,
        simulation.outcome,
        simulation.cause or "",
        deviation.multiple,
        None if told is None else told.value,
        process_time() - begun,
    )


@cache
def _planned(name: str, reserve: float) -> tuple[PlateLiftTask, Plan]:
    """Plan a shipped task with a reserve, once in this process."""
    task = read_task(task_body(name, reserve=reserve))
    assert isinstance(task, PlateLiftTask)
    return task, Plan.read(plan(task, build_scene(task), silent, process_time).write())
