"""What commands say and write: refusals, progress, and results that are written whole or not at all."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from errno import ENOENT
from pathlib import Path
from types import TracebackType
from typing import Any, Self, TextIO

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn

from planners.errors import LiftwrightError

BAD_INPUT = 3
"""Exit code."""


class BadInput(LiftwrightError):
    """A file is not what a command takes; the message names it."""


def refuse(problems: Iterable[Mapping[str, Any]], file: str) -> int:
    """Print every problem of a file, as `planners.contract.problems` lists them, and return the exit code."""
    for problem in problems:
        choices = problem.get("allowed")
        allowed = f" (one of: {', '.join(choices)})" if choices else ""
        sys.stderr.write(f"{problem['pointer'] or file}: {problem['detail']}{allowed}\n")
    return BAD_INPUT


class ProgressBar:
    """Shows one job; nothing but its end is left on a screen that is no terminal."""

    def __init__(self) -> None:
        columns = (TextColumn("{task.description:<12}"), BarColumn(), TaskProgressColumn(), TimeElapsedColumn())
        self._bar = Progress(*columns, console=Console(stderr=True))
        self._job = self._bar.add_task("waiting", total=1.0)

    def __enter__(self) -> Self:
        self._bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bar.stop()

    def show(self, stage: str, fraction: float) -> None:
        """Show the stage and how much of the whole is done, 0 … 1."""
        self._bar.update(self._job, description=stage, completed=fraction)

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
    if out.exists() and not out.is_file():
        # A pipe or a terminal; of a directory the system says so itself.
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
