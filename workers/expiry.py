"""Jobs whose time is over: whoever ordered them has no use for their plans any more."""

from __future__ import annotations

import structlog

from workers.job_queue import JobQueue
from workers.plan_store import PlanStore
from workers.time_stamp import now_us

BATCH = 100

log = structlog.get_logger(__name__)


class Expiry:
    """Cancels jobs that have not ended by the end of their order. Any number of workers may do so."""

    def __init__(self, store: PlanStore, queue: JobQueue) -> None:
        self._store, self._queue = store, queue

    def sweep(self) -> None:
        """Cancel what is overdue now."""
        overdue = self._store.overdue(now_us(), BATCH)
        if not overdue:
            return
        # First, so that a job which is seen to be cancelled is seen with what it was cancelled by.
        self._store.mark_overdue(overdue)
        for plan_id in overdue:
            self._queue.cancel(plan_id)
        # A worker may have begun it in between, and taken its end away.
        self._store.mark_overdue(overdue)
        log.info("jobs cancelled at the end of their time", job_ids=overdue)
