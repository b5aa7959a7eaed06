"""Attempts on disk: a run that was stopped goes on where it was, as long as the code is the same."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import BrokenExecutor, Executor, ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from dataclasses import asdict
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, ClassVar, Generic, Protocol, Self, TypeVar

from tests.benchmarks.machine import ROOT
from tests.benchmarks.tasks import Note

FOLDER = ROOT / "build" / "benchmarks"
"""Where a full run keeps what it has done."""
PLANNING = ("assets", "planners", "workers")
"""What plans, and what came of a plan, depend on."""
SERVING = ("app", "workers")
"""What is killed, and takes over; how a plan is found is the same to it."""


class Attempt(Protocol):
    """What came of one attempt: a dataclass of what JSON can hold."""

    __dataclass_fields__: ClassVar[dict[str, Any]]

    @classmethod
    def broken(cls, key: Any, error: BaseException) -> Self:
        """Return the attempt at which the planner raised what it should not raise."""
        ...

    @property
    def key(self) -> Hashable:
        """What was attempted."""
        ...

    def told(self) -> str:
        """Say in a line what came of it."""
        ...


Kind = TypeVar("Kind", bound=Attempt)
Key = TypeVar("Key", bound=Hashable)
Variant = TypeVar("Variant", bound=Hashable)


@contextmanager
def kept_attempts(resumed: bool) -> Iterator[Path]:
    """Give the folder of attempts: the one that outlives the run, or one that nothing is in and that goes with it."""
    if resumed:
        yield FOLDER
    else:
        with TemporaryDirectory() as fresh:
            yield Path(fresh)


class Unfinished(Exception):
    """Attempts are left: the same command goes on with them."""


class AttemptFile(Generic[Kind]):
    """Attempts of one kind that were made with one state of the code, one on each line."""

    def __init__(self, path: Path, kind: type[Kind]) -> None:
        """Open a file; a last line that was cut off is dropped."""
        self._path, self._kind = path, kind
        if path.exists():
            whole = path.read_bytes()
            path.write_bytes(whole[: whole.rfind(b"\n") + 1])

    @classmethod
    def of_this_code(
        cls, folder: Path, kind: type[Kind], name: str, measuring: Sequence[str], measured: Sequence[str] = PLANNING
    ) -> Self:
        """Return the file of the code as it is, changes that are not committed included.

        Args:
            folder: of all such files.
            kind: of attempts.
            name: of the file, to which a digest of the code is added.
            measuring: files of this folder on which attempts depend, besides what is measured.
            measured: folders of the product on which they depend.
        """
        folder.mkdir(parents=True, exist_ok=True)
        return cls(folder / f"{name}_{_digest(_sources(measuring, measured))}.jsonl", kind)

    def read(self) -> dict[Hashable, Kind]:
        """Return the attempts by what was attempted."""
        if not self._path.exists():
            return {}
        attempts = [self._kind(**json.loads(line)) for line in self._path.read_text().splitlines()]
        return {attempt.key: attempt for attempt in attempts}

    def add(self, attempt: Kind) -> None:
        """Write an attempt down."""
        with self._path.open("a") as file:
            file.write(json.dumps(asdict(attempt)) + "\n")

    def complete(
        self,
        processes: Executor,
        work: Mapping[Key, Callable[[], Kind]],
        note: Note,
        most: int | None = None,
    ) -> dict[Key, Kind]:
        """Make the attempts that are missing, and return all that were asked for.

        Args:
            processes: where they are made.
            work: how to make each.
            note: told of each.
            most: how many to make before the run stops; None: all.

        Raises:
            Unfinished: more than `most` were missing.
        """
        known = self.read()
        missing = [key for key in work if key not in known]
        now = missing[:most]
        jobs = {processes.submit(work[key]): key for key in now}
        for number, job in enumerate(as_completed(jobs), start=1):
            error = job.exception()
            if isinstance(error, BrokenExecutor):
                raise error
            attempt = job.result() if error is None else self._kind.broken(jobs[job], error)
            self.add(attempt)
            note(f"{number} of {len(missing)}: {attempt.told()}")
        if len(now) < len(missing):
            raise Unfinished(f"{len(missing) - len(now)} of {len(work)} attempts are left")
        known = self.read()
        return {key: known[key] for key in work}


def repeated(
    file: AttemptFile[Kind],
    make: Callable[[str, Variant, int], Kind],
    cases: Sequence[tuple[str, Variant]],
    seeds: int,
    processes: int,
    note: Note,
    most: int | None = None,
) -> list[list[Kind]]:
    """Make the attempts of each case, in a few processes, and return them by seed.

    Those of one case are made in a row: what a process prepares for a case it need prepare only once.

    Args:
        file: of attempts, whose key is task, variant and seed.
        make: an attempt of a case with a seed; it is sent to a process.
        cases: tasks with what is varied.
        seeds: of each case, from 0.
        processes: at a time.
        note: told of each.
        most: how many to make before the run stops; None: all.

    Raises:
        Unfinished: more than `most` were missing.
    """
    work = {
        (task, variant, seed): partial(make, task, variant, seed) for task, variant in cases for seed in range(seeds)
    }
    with ProcessPoolExecutor(processes, mp_context=get_context("spawn")) as executor:
        done = file.complete(executor, work, note, most)
    return [[done[task, variant, seed] for seed in range(seeds)] for task, variant in cases]


def _sources(measuring: Sequence[str], measured: Sequence[str]) -> list[Path]:
    files = [path for folder in measured for path in (ROOT / folder).rglob("*") if path.is_file()]
    files += [Path(__file__).parent / name for name in measuring]
    return sorted(path for path in files if "__pycache__" not in path.parts)


def _digest(files: Iterable[Path]) -> str:
    digest = hashlib.sha256()
    for file in files:
        digest.update(str(file.relative_to(ROOT)).encode() + b"\0" + file.read_bytes() + b"\0")
    return digest.hexdigest()[:12]
