"""What an MES says about a job beside its task: the names are those of ISA-95."""

from __future__ import annotations

from dataclasses import dataclass

HIGHEST_PRIORITY = 9


@dataclass(frozen=True)
class JobOrder:
    """When a job is to be done, and who is told. Times are microseconds since 1970, UTC."""

    webhook_id: str | None = None
    """Of the owner's webhook that is told when the job ends, beside those that want to know of all."""
    work_master: str | None = None
    """The recipe by which the caller made the task, in its own words."""
    priority: int = 0
    """0 … 9; the highest goes first, and of equal ones the oldest."""
    start_us: int | None = None
    """The job is not begun before."""
    end_us: int | None = None
    """A job that has not ended by then is cancelled."""

    def pause(self, time_us: int) -> float:
        """Return how long the job must wait, at a time, before it may be begun [s]."""
        return 0.0 if self.start_us is None else max(0.0, (self.start_us - time_us) / 1e6)
