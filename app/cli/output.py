"""What commands say and write: refusals, progress, and results that are written whole or not at all."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from errno import EISDIR, ENOENT
from pathlib import Path
from types import MappingProxyType, TracebackType
from typing import Self, TextIO

from planners.contract.problems import Problem
from planners.errors import LiftwrightError
from planners.remedies.kinds import KINDS

BAD_INPUT = 3
"""Exit code."""
STAGES = MappingProxyType(
    {
        "load": "loading the planner",
        "scene": "building the scene",
        "cup places": "trying places of the cup",
        "sample": "sampling poses of the plate",
        "reach": "finding what the hands reach",
        "merge": "building the graph",
        "examine": "balancing forces of all holds",
        "search": "searching a path",
        "motion": "planning arm motions",
        "denser": "searching again, more poses and holds",
        "reserve": "searching for the largest reserve",
        "tolerances": "looking at tolerances of the plate",
        "handovers": "computing handovers of the tool",
        "suction": "finding suction poses",
        "first regrasp": "grasps for taking up",
        "second regrasp": "grasps for putting down",
        "regrasp graph": "searching regrasps",
        "first motion": "planning motions for taking up",
        "second motion": "planning motions for putting down",
        "forces": "computing contact forces",
        "remedies": "trying changes that would help",
        "certify": "checking the plan independently",
        "simulate": "simulating the plan",
    }
)
"""What a stage of a job is called to a person who watches it, by its name."""
LINE_SECONDS = 10.0
"""Between two lines of progress where there is no terminal [s]."""


class BadInput(LiftwrightError):
    """A file is not what a command takes; the message names it."""


def said_of(error: OSError) -> str:
    """Return which file the system means, and what it says of it."""
    return str(error) if error.filename is None else f"{error.filename}: {error.strerror}"


class Refused(LiftwrightError):
    """What a file says cannot be done."""

    def __init__(self, problems: Sequence[Problem]) -> None:
        self.problems = problems
        super().__init__("; ".join(problem.detail for problem in problems))


def refuse(problems: Iterable[Problem], file: str, line_of: Callable[[str], int | None] | None = None) -> int:
    """Print every problem of a file, and return the exit code.

    Args:
        problems: what is wrong.
        file: what problems of the whole of it are said of.
        line_of: finds the line of a JSON pointer, where lines are known.
    """
    for problem in problems:
        sys.stderr.write(f"{_told(problem, file, line_of)}\n")
    return BAD_INPUT


def warn(problems: Iterable[Problem], file: str, line_of: Callable[[str], int | None] | None = None) -> None:
    """Print what may be wrong with a file that is taken all the same; arguments as of `refuse`."""
    for problem in problems:
        sys.stderr.write(f"warning: {_told(problem, file, line_of)}\n")


def _told(problem: Problem, file: str, line_of: Callable[[str], int | None] | None) -> str:
    allowed = f" (one of: {', '.join(problem.allowed)})" if problem.allowed else ""
    line = None if line_of is None else line_of(problem.pointer)
    where = f" (line {line})" if line is not None and problem.pointer else ""
    return f"{problem.place or file}{where}: {problem.detail}{allowed}"


def stage_words(name: str) -> str:
    """Return words for a stage as reports and plans name it, with the object it is about if it has one.

    A stage of another version, which is not known here, is called as it is.
    """
    if name in STAGES:
        return STAGES[name]
    stage, _, about = name.rpartition(" ")
    about = KINDS.get(about, about) if stage == "remedies" else about
    return f"{STAGES[stage]} ({about})" if stage in STAGES else name


class ProgressBar:
    """Shows one job; where there is no terminal, in a line now and then, and its end."""

    def __init__(self, job: str = "") -> None:
        """Take what the job is called, where there are several."""
        # Here, because a task that is refused needs none of it.
        from rich.console import Console
        from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn

        self._name = f"{job}: " if job else ""
        columns = (TextColumn("{task.description:<36}"), BarColumn(), TaskProgressColumn(), TimeElapsedColumn())
        self._bar = Progress(*columns, console=Console(stderr=True))
        self._job = self._bar.add_task(f"{self._name}waiting", total=1.0)
        self._told = time.monotonic()

    def __enter__(self) -> Self:
        self._bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bar.stop()

    def show(self, stage: str, fraction: float) -> None:
        """Show the stage, as a plan names it, and how much of the whole is done, 0 … 1."""
        self._bar.update(self._job, description=self._name + stage_words(stage), completed=fraction)
        now = time.monotonic()
        if not self._bar.console.is_terminal and now - self._told >= LINE_SECONDS:
            self._told = now
            self.say(f"{self._name}{stage_words(stage)}, {100 * fraction:.0f} %")

    def say(self, sentence: str) -> None:
        """Print a line over the bar, on any screen."""
        self._bar.console.print(sentence, markup=False, highlight=False, soft_wrap=True)


@contextmanager
def written_whole(out: Path | None) -> Iterator[TextIO | None]:
    """Open a file beside `out` that takes its place at the end: an impossible place is told before the work.

    Raises:
        OSError: Nothing can be written there.
    """
    if out is None:
        yield None
        return
    if out.is_dir():
        raise IsADirectoryError(EISDIR, "is a folder; name a file in it", str(out))
    if out.exists() and not out.is_file():
        # A pipe or a terminal.
        with out.open("w", encoding="utf-8") as stream:
            yield stream
        return
    if not out.parent.is_dir():
        raise FileNotFoundError(ENOENT, "no such folder", str(out))
    partial = out.with_name(f".{out.name}.{os.getpid()}")
    try:
        file = partial.open("x", encoding="utf-8")
    except OSError as error:
        # Whoever reads this has named another file.
        error.filename = str(out)
        raise
    try:
        with file:
            yield file
        partial.replace(out)
    finally:
        partial.unlink(missing_ok=True)
