"""Jobs that have failed without anybody being there to say so."""

from __future__ import annotations

import asyncio

import structlog

from workers.database_loss import DATABASE_GONE
from workers.plan_store import PlanStore

BATCH = 100

log = structlog.get_logger(__name__)


class FailureWatch:
    """Counts what the engine has given up or seen end by an error. Any number of workers may do so."""

    def __init__(self, store: PlanStore, watch_seconds: float) -> None:
        self._store, self._watch_seconds = store, watch_seconds

    async def run(self) -> None:
        """Look for such jobs until cancelled; a database that is gone is waited for."""
        while True:
            await asyncio.sleep(self._watch_seconds)
            try:
                await asyncio.to_thread(self.sweep)
            except DATABASE_GONE as error:
                log.warning("failed jobs not looked for", error=str(error.args[0] if error.args else error))

    def sweep(self) -> None:
        """Count what has failed by now."""
        failed = self._store.count_failures(BATCH)
        if failed:
            log.error("jobs failed without a solver's word", job_ids=failed)
