"""How long work tells what it is doing, and how it is told to stop."""

from __future__ import annotations

from typing import Protocol


class Progress(Protocol):
    """Called by a planner with the stage it is in. Raises `PlanningCancelled` when the work should stop."""

    def __call__(self, stage: str, done: int, total: int) -> None:
        """Report that `done` of `total` parts of `stage` are finished; `total` 0 means the number is not known."""
        ...


def silent(stage: str, done: int, total: int) -> None:
    """Report nothing and never cancel."""
