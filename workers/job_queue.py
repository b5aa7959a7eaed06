"""The engine as seen from outside: enqueue, look, cancel, forget. Works without running any job itself."""

from __future__ import annotations

from collections.abc import Sequence

import sqlalchemy as sa
from dbos import DBOSClient, EnqueueOptions, WorkflowSerializationFormat, WorkflowStatus

from workers.database import Database
from workers.job_state import STATE_OF_STATUS, Job, JobState

QUEUE = "plans"
WORKFLOW = "plan"
APPLICATION = "liftwright"
APPLICATION_VERSION = "1"
"""Pinned: by default it is a hash of the code, and jobs of another version are neither begun nor recovered."""
INTERRUPTED_TOO_OFTEN = "the worker died each time it ran this job, so it is not begun again"


class JobQueue:
    """Jobs are named by their plan's id."""

    def __init__(self, database: Database) -> None:
        self._client = DBOSClient(system_database_url=database.engine_url, application_name=APPLICATION)

    def close(self) -> None:
        """Give all connections back."""
        self._client.destroy()

    def open(self, worker_slots: int, poll_seconds: float) -> None:
        """Have every worker take at most `worker_slots` jobs at a time, and look for new ones so often [s]."""
        self._client.register_queue(
            QUEUE,
            worker_concurrency=worker_slots,
            polling_interval_sec=poll_seconds,
            on_conflict="always_update",
        )

    def enqueue(self, transaction: sa.Connection, plan_id: str) -> None:
        """Enqueue a job; it exists when `transaction` commits."""
        options: EnqueueOptions = {
            "workflow_name": WORKFLOW,
            "queue_name": QUEUE,
            "workflow_id": plan_id,
            "app_version": APPLICATION_VERSION,
            "serialization_type": WorkflowSerializationFormat.PORTABLE,
        }
        self._client.enqueue_in_transaction(transaction, options, plan_id)

    def jobs(self, plan_ids: Sequence[str]) -> dict[str, Job]:
        """Return the jobs of `plan_ids`; one that does not exist is left out."""
        if not plan_ids:
            return {}
        found = self._client.list_workflows(workflow_ids=list(plan_ids), load_input=False)
        return {status.workflow_id: _job(status) for status in found}

    def cancelled(self, plan_ids: Sequence[str]) -> set[str]:
        """Return those of `plan_ids` whose job was cancelled or no longer exists."""
        found = self._client.list_workflows(workflow_ids=list(plan_ids), load_input=False, load_output=False)
        return set(plan_ids) - {status.workflow_id for status in found if status.status != "CANCELLED"}

    def cancel(self, plan_id: str) -> None:
        """Cancel a job; one that has ended stays as it is."""
        self._client.cancel_workflow(plan_id)

    def forget(self, plan_id: str) -> None:
        """Remove all the engine knows of a job."""
        self._client.delete_workflow(plan_id)

    def unfinished(self, most: int) -> list[JobState]:
        """Return the states of at most `most` jobs that have not ended."""
        found = self._client.list_queued_workflows(queue_name=QUEUE, load_input=False, limit=most)
        return [STATE_OF_STATUS[status.status] for status in found]


def _job(status: WorkflowStatus) -> Job:
    state = STATE_OF_STATUS[status.status]
    error = None
    if state is JobState.FAILED:
        error = INTERRUPTED_TOO_OFTEN if status.error is None else str(status.error)
    return Job(state, error, None if not state.done or status.updated_at is None else status.updated_at * 1000)
