"""Random layouts of each pile: how many are solved and certified, and in what time."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor
from dataclasses import dataclass
from functools import cache, partial
from multiprocessing import get_context
from pathlib import Path

from planners.cell.cell import load_cells
from tests.benchmarks.attempt_file import AttemptFile
from tests.benchmarks.pile_attempt import PileAttempt, PileWorker
from tests.benchmarks.random_piles import PILES, Pile, refusal
from tests.benchmarks.tasks import Note

LAYOUTS = 100
PROCESSES = 2
MOST_SEEDS = 5000
"""Of one pile that are looked at."""
_SEEDS_AT_ONCE = 20
_MEASURING = ("random_piles.py", "pile_attempt.py", "certified_plan.py")


@dataclass(frozen=True)
class PileFigures:
    """One pile over all its layouts."""

    pile: Pile
    refused: Counter[str]
    """Seeds whose start the service refuses, by reason."""
    attempts: Sequence[PileAttempt]
    """By seed."""

    @property
    def seeds(self) -> int:
        """All that were looked at."""
        return self.refused.total() + len(self.attempts)

    @property
    def solved(self) -> list[PileAttempt]:
        """Those that were planned and certified."""
        return [attempt for attempt in self.attempts if attempt.solved]

    @property
    def straightforward(self) -> list[PileAttempt]:
        """Those that were solved with nothing put aside."""
        return [attempt for attempt in self.solved if not attempt.put_aside]

    @property
    def failed(self) -> list[PileAttempt]:
        """The others."""
        return [attempt for attempt in self.attempts if not attempt.solved]

    @property
    def planning_per_object(self) -> list[float]:
        """Wall clock from spec to document over the number of objects, of each attempt [s]."""
        return [attempt.planning / self.pile.objects for attempt in self.attempts]

    @property
    def cpu_per_object(self) -> list[float]:
        """The same in CPU time [s]."""
        return [attempt.planning_cpu / self.pile.objects for attempt in self.attempts]


@dataclass(frozen=True)
class PileSeeds:
    """Which seeds give a pile's layouts."""

    good: Sequence[int]
    refused: Counter[str]
    """Those whose start the service refuses, by reason."""


def measure(note: Note, kept: Path, piles: Sequence[Pile] = PILES, layouts: int = LAYOUTS) -> list[PileFigures]:
    """Plan and certify so many layouts of each pile in a few processes.

    Args:
        note: told of each that is done.
        kept: folder of attempts, which are not repeated while the code is the same, and of handover databases.
        piles: which.
        layouts: of each.
    """
    file = attempt_file(kept)
    with ProcessPoolExecutor(PROCESSES, mp_context=get_context("spawn")) as processes:
        seeds = {pile: _seeds(processes, pile, layouts, note) for pile in piles}
        work = {(pile.name, seed): partial(_attempt, kept, pile, seed) for pile in piles for seed in seeds[pile].good}
        attempts = file.complete(processes, work, lambda told: note(f"piles: {told}"))
    return [
        PileFigures(pile, each.refused, [attempts[pile.name, seed] for seed in each.good])
        for pile, each in seeds.items()
    ]


def attempt_file(kept: Path) -> AttemptFile[PileAttempt]:
    """Return where attempts with the code as it is are kept."""
    return AttemptFile.of_this_code(
        kept, PileAttempt, "piles", ("random_piles.py", "pile_attempt.py", "certified_plan.py")
    )


def _seeds(processes: Executor, pile: Pile, layouts: int, note: Note) -> PileSeeds:
    """Look at one seed after the other until there are as many layouts as wanted."""
    note(f"piles: laying {pile.name}")
    good: list[int] = []
    refused: Counter[str] = Counter()
    for seed, reason in _refusals(processes, pile):
        if len(good) == layouts:
            break
        if reason is None:
            good.append(seed)
        else:
            refused[reason] += 1
    return PileSeeds(good, refused)


def _refusals(processes: Executor, pile: Pile) -> Iterator[tuple[int, str | None]]:
    for first in range(0, MOST_SEEDS, _SEEDS_AT_ONCE):
        seeds = range(first, first + _SEEDS_AT_ONCE)
        yield from zip(seeds, processes.map(partial(_refusal, pile), seeds), strict=True)


def _refusal(pile: Pile, seed: int) -> str | None:
    """Return why a seed gives no layout, with equal words for equal objects; None where it gives one."""
    reason = refusal(pile, seed, load_cells())
    if reason is None:
        return None
    reason = re.sub(r"(tool_rest)_\w+", r"\1", re.sub(r"_\d+\b", "", reason))
    reason = re.sub(r"overlap by [\d.]+ mm", "overlap", reason.partition("; moved ")[0])
    return re.sub(r"is [\d.]+ mm deep", "is deep", reason)


def _attempt(databases: Path, pile: Pile, seed: int) -> PileAttempt:
    return _warm_worker(databases, pile).attempt(pile, seed)


@cache
def _worker(databases: Path) -> PileWorker:
    return PileWorker(databases)


@cache
def _warm_worker(databases: Path, pile: Pile) -> PileWorker:
    """Return this process's worker with all kernels loaded that a pile needs."""
    worker = _worker(databases)
    worker.warm_up(pile)
    return worker
