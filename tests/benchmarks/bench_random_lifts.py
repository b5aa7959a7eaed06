"""Random plate lifts: how many are solved and certified, in what time, and how many are wrongly not found."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import cache, partial
from itertools import count
from multiprocessing import get_context
from pathlib import Path

from planners.cell.cell import load_cells
from tests.benchmarks import lift_attempt
from tests.benchmarks.attempt_file import AttemptFile
from tests.benchmarks.lift_attempt import INFEASIBLE, NOT_FOUND, LiftAttempt
from tests.benchmarks.random_lifts import refusal
from tests.benchmarks.tasks import Note
from workers.solver.pipeline import Pipeline

LIFTS = 200
PROCESSES = 2
_MEASURING = ("random_lifts.py", "lift_attempt.py", "certified_plan.py")


@dataclass(frozen=True)
class RandomLiftFigures:
    """All random lifts."""

    refused: Counter[str]
    """Draws that the service refuses, by reason."""
    attempts: Sequence[LiftAttempt]
    """By seed, at the densities that a task has by default."""
    second_looks: Sequence[LiftAttempt]
    """At those that were not found, denser, by seed."""

    @property
    def draws(self) -> int:
        """All that were looked at."""
        return self.refused.total() + len(self.attempts)

    def ended(self, outcome: str) -> list[LiftAttempt]:
        """Return the attempts that ended so."""
        return [attempt for attempt in self.attempts if attempt.outcome == outcome]

    @property
    def solved(self) -> list[LiftAttempt]:
        """Those that were planned and certified."""
        return [attempt for attempt in self.attempts if attempt.solved]

    @property
    def broken(self) -> list[LiftAttempt]:
        """Those that ended as no task may: uncertified, or with an error."""
        answers = (NOT_FOUND, INFEASIBLE)
        attempts = (*self.attempts, *self.second_looks)
        return [attempt for attempt in attempts if not attempt.solved and attempt.outcome not in answers]

    @property
    def wrongly_not_found(self) -> list[LiftAttempt]:
        """The second looks that found a plan which is certified."""
        return [attempt for attempt in self.second_looks if attempt.solved]

    @property
    def wrong_share(self) -> float:
        """Of all lifts that were not found, those for which there is a plan after all [1]."""
        looks = len(self.second_looks)
        return len(self.wrongly_not_found) / looks if looks else 0.0


def measure(
    note: Note, kept: Path, lifts: int = LIFTS, processes: int = PROCESSES, most: int | None = None
) -> RandomLiftFigures:
    """Plan and certify so many random lifts, and look once more, denser, for those that are not found.

    Args:
        note: told of each that is done.
        kept: folder of attempts, which are not repeated while the code is the same.
        lifts: how many that are not refused.
        processes: at a time.
        most: how many attempts to make before the run stops; None: all.

    Raises:
        Unfinished: more than `most` are missing.
    """
    seeds, refused = _seeds(lifts)
    file = AttemptFile.of_this_code(kept, LiftAttempt, "random_lifts", _MEASURING)

    def told(words: str) -> None:
        note(f"random lifts: {words}")

    with ProcessPoolExecutor(processes, mp_context=get_context("spawn")) as executor:
        known = len(file.read())
        first = file.complete(executor, {(seed, False): partial(_attempt, seed) for seed in seeds}, told, most)
        again = [seed for seed in seeds if first[seed, False].outcome == NOT_FOUND]
        left = None if most is None else most - (len(file.read()) - known)
        looks = file.complete(executor, {(seed, True): partial(_dense_attempt, seed) for seed in again}, told, left)
    return RandomLiftFigures(refused, list(first.values()), list(looks.values()))


def _seeds(lifts: int) -> tuple[list[int], Counter[str]]:
    """Take one seed after the other until there are as many lifts as wanted; count the others by reason."""
    cells = load_cells()
    good: list[int] = []
    refused: Counter[str] = Counter()
    for seed in count():
        if len(good) == lifts:
            break
        reason = refusal(seed, cells)
        if reason is None:
            good.append(seed)
        else:
            refused[reason] += 1
    return good, refused


def _attempt(seed: int) -> LiftAttempt:
    return lift_attempt.attempt(_pipeline(), seed)


def _dense_attempt(seed: int) -> LiftAttempt:
    return lift_attempt.dense_attempt(_pipeline(), seed)


@cache
def _pipeline() -> Pipeline:
    """Return this process's pipeline, with the kernels loaded that a lift needs."""
    return Pipeline.load().warm_up()
