"""How long work tells what it is doing, and how it is told to stop."""

from __future__ import annotations

from typing import NamedTuple, Protocol


class Report(NamedTuple):
    """What is being done, and how much of it."""

    stage: str
    """"scene", "search", "first regrasp" and the like."""
    done: int
    total: int
    """Parts of the stage that are finished, and that there are; `total` 0 means the number is not known [1]."""
    object: str | None = None
    """Of which object of the task, where a stage is that of a single one; of "remedies": the kind of change that is
    tried."""

    @property
    def name(self) -> str:
        """The stage as people and plans name it: with the object, if it has one."""
        return self.stage if self.object is None else f"{self.stage} {self.object}"


class Progress(Protocol):
    """Called by a planner with what it does. Raises `PlanningCancelled` when the work should stop."""

    def __call__(self, report: Report, /) -> None:
        """Take a report."""
        ...


def silent(_: Report, /) -> None:
    """Report nothing and never cancel."""
