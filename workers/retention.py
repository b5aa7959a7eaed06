"""Forgets plans that ended long ago, with documents and events, and scenes that nobody names any more.

Meshes stay, since tasks may name them for ever.
"""

from __future__ import annotations

import structlog

from workers.job_queue import JobQueue
from workers.plan_store import PlanStore
from workers.scene_store import SceneStore
from workers.time_stamp import now_us

PAUSE_SECONDS = 3600.0
"""Between two rounds [s]."""
BATCH = 200
US_PER_DAY = 86_400_000_000

log = structlog.get_logger(__name__)


class Retention:
    """A scheduled job of every worker. Two that meet do no harm: what is gone is gone."""

    def __init__(self, store: PlanStore, scenes: SceneStore, queue: JobQueue, days: float) -> None:
        self._store, self._scenes, self._queue, self._days = store, scenes, queue, days

    def sweep(self) -> int:
        """Delete every plan that ended more than so many days ago, and return how many there were.

        Scenes that were last posted before then go too, unless a plan that is left names them.
        """
        before = now_us() - round(self._days * US_PER_DAY)
        position, gone = (0, ""), 0
        while batch := self._store.created_before(before, position, BATCH):
            position = batch[-1]
            jobs = self._queue.jobs([plan_id for _, plan_id in batch])
            for _, plan_id in batch:
                job = jobs.get(plan_id)
                if job is None or (job.state.done and (job.ended_us or 0) < before):
                    # In this order: a plan without a job is found again by the next round.
                    self._queue.forget(plan_id)
                    self._store.delete(plan_id)
                    gone += 1
        scenes = self._scenes.delete_before(before)
        if gone or scenes:
            log.info("old plans deleted", plans=gone, scenes=scenes, days=self._days)
        return gone
