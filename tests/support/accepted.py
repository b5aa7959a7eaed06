"""Tasks that a store has accepted, one at a time."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from workers.stores.job_queue import JobQueue
from workers.stores.plan_store import NO_ORDER, Accepted, JobOrder, PlanRecord, PlanStore, Submission


def accept(
    store: PlanStore,
    task: Mapping[str, Any],
    key: str | None,
    queue: JobQueue,
    owner: str | None = None,
    order: JobOrder = NO_ORDER,
) -> PlanRecord:
    """Store one task and enqueue its job, as `PlanStore.accept_all` does, however many jobs there are."""
    (accepted,) = store.accept_all([Submission.of(task, owner, order, key, None)], queue)
    assert isinstance(accepted, Accepted)
    return accepted.record
