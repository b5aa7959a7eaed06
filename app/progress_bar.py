"""A progress bar on stderr."""

from __future__ import annotations

from types import TracebackType
from typing import Self

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn


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
