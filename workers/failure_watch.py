"""Jobs that have failed without anybody being there to say so."""

from __future__ import annotations

import structlog

from workers.plan_store import PlanStore

BATCH = 100

log = structlog.get_logger(__name__)


class FailureWatch:
    """Counts what the engine has given up or seen end by an error. Any number of workers may do so."""

    def __init__(self, store: PlanStore) -> None:
        self._store = store

    def sweep(self) -> None:
        """Count what has failed by now."""
        failed = self._store.count_failures(BATCH)
        if failed:
            log.error("jobs failed without a solver's word", job_ids=failed)
