"""A job: what its caller orders, the states it goes through, and how the job engine's own table has them.

The engine's own calls fetch whole rows where a count is wanted, and hand over the jobs of a dead worker only with a
service that is sold separately; so we read, and repair, its table of workflows ourselves.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

import sqlalchemy as sa

HIGHEST_PRIORITY = 9
PUT_OFF = 100
"""Is added to the engine's priority of a job whose verdict is known, and that waits for the rest of its answer."""

POSTGRES_SCHEMA = "dbos"
ENQUEUED = "ENQUEUED"
DELAYED = "DELAYED"
"""Until the start of its order."""
QUEUED = (ENQUEUED, DELAYED)
RUNNING = "PENDING"
SUCCEEDED = "SUCCESS"
FAILED = "ERROR"
GIVEN_UP = "MAX_RECOVERY_ATTEMPTS_EXCEEDED"
CANCELLED = "CANCELLED"


@dataclass(frozen=True)
class JobOrder:
    """What an MES says about a job beside its task: when it is to be done, and who is told. The names are ISA-95's.

    Times are microseconds since 1970, UTC.
    """

    webhook_id: str | None = None
    """Of the owner's webhook that is told when the job ends, beside those that want to know of all."""
    work_master: str | None = None
    """The recipe by which the caller made the task, in its own words."""
    priority: int = 0
    """0 … 9; of its owner's jobs the highest goes first, and of equal ones the oldest."""
    start_us: int | None = None
    """The job is not begun before."""
    end_us: int | None = None
    """A job that has not ended by then is cancelled."""

    def pause(self, time_us: int) -> float:
        """Return how long the job must wait, at a time, before it may be begun [s]."""
        return 0.0 if self.start_us is None else max(0.0, (self.start_us - time_us) / 1e6)


class JobState(Enum):
    """Where a job stands. The value is what the outside sees."""

    QUEUED = "queued"
    RUNNING = "running"
    SUCCEEDED = "succeeded"
    FAILED = "failed"
    CANCELLED = "cancelled"

    @property
    def done(self) -> bool:
        """Whether the job will never change again."""
        return self not in (JobState.QUEUED, JobState.RUNNING)


STATE_OF_STATUS = {
    ENQUEUED: JobState.QUEUED,
    DELAYED: JobState.QUEUED,
    RUNNING: JobState.RUNNING,
    SUCCEEDED: JobState.SUCCEEDED,
    FAILED: JobState.FAILED,
    GIVEN_UP: JobState.FAILED,
    CANCELLED: JobState.CANCELLED,
}
"""What the engine's words for the status of a workflow mean, unless its job is put off."""


def state_of(status: str, priority: int) -> JobState:
    """Return where a job stands, by what the engine has of it; one that is put off runs, whoever looks at it."""
    return JobState.RUNNING if status == ENQUEUED and priority > PUT_OFF else STATE_OF_STATUS[status]


def in_state(jobs: sa.TableClause, state: JobState) -> sa.ColumnElement[bool]:
    """Return what holds of jobs in a state, in the engine's table."""
    put_off = sa.and_(jobs.c.status == ENQUEUED, jobs.c.priority > PUT_OFF)
    meant = jobs.c.status.in_([status for status, means in STATE_OF_STATUS.items() if means is state])
    match state:
        case JobState.QUEUED:
            return sa.and_(meant, sa.not_(put_off))
        case JobState.RUNNING:
            return sa.or_(meant, put_off)
        case _:
            return meant


@dataclass(frozen=True)
class Job:
    """One run of a task, as the engine knows it."""

    state: JobState
    error: str | None
    """A sentence, if the job failed."""
    ended_us: int | None
    """When it ended, as coarsely as the engine knows [microseconds since 1970, UTC]."""


def together(parts: Sequence[Job]) -> Job:
    """Return how a whole stands of which each part is a job, at least one.

    It ends when all of them have, and as badly as any of them; until then it runs once one was begun.
    """
    states = {part.state for part in parts}
    ended = max((part.ended_us or 0 for part in parts), default=0) or None
    # A part that was cancelled ends the whole: others are only not told yet.
    if JobState.CANCELLED in states:
        return Job(JobState.CANCELLED, None, ended)
    if all(state.done for state in states):
        error = next((part.error for part in parts if part.error is not None), None)
        return Job(JobState.FAILED if JobState.FAILED in states else JobState.SUCCEEDED, error, ended)
    return Job(JobState.QUEUED if states == {JobState.QUEUED} else JobState.RUNNING, None, None)


def workflow_table(dialect: str) -> sa.TableClause:
    """Return the engine's table of workflows as it is named on `sqlite` or `postgresql`."""
    return sa.table(
        "workflow_status",
        sa.column("workflow_uuid", sa.Text),
        sa.column("status", sa.Text),
        sa.column("name", sa.Text),
        sa.column("queue_name", sa.Text),
        sa.column("queue_partition_key", sa.Text),
        sa.column("application_name", sa.Text),
        sa.column("application_version", sa.Text),
        sa.column("serialization", sa.Text),
        sa.column("recovery_attempts", sa.BigInteger),
        sa.column("creator_xid", sa.Text),
        sa.column("delay_until_epoch_ms", sa.BigInteger),
        sa.column("executor_id", sa.Text),
        sa.column("owner_xid", sa.Text),
        sa.column("priority", sa.Integer),
        sa.column("created_at", sa.BigInteger),
        sa.column("started_at_epoch_ms", sa.BigInteger),
        sa.column("updated_at", sa.BigInteger),
        sa.column("completed_at", sa.BigInteger),
        schema=POSTGRES_SCHEMA if dialect == "postgresql" else None,
    )


def input_table(dialect: str) -> sa.TableClause:
    """Return the engine's table of what workflows are called with, as it is named on `sqlite` or `postgresql`."""
    return sa.table(
        "workflow_input",
        sa.column("workflow_uuid", sa.Text),
        sa.column("inputs", sa.Text),
        sa.column("retention_timestamp", sa.BigInteger),
        schema=POSTGRES_SCHEMA if dialect == "postgresql" else None,
    )
