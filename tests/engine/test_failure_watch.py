"""Every job that fails is counted once, by why, also where nobody was there to say so."""

from __future__ import annotations

import pytest
import sqlalchemy as sa

from app.access.caller import ANYBODY
from app.resources.plan_collection import PlanCollection
from tests.support.accepted import accept
from tests.support.service import task
from workers.engine.housekeeping import count_failures
from workers.stores.database import Database
from workers.stores.job_queue import JobQueue
from workers.stores.jobs import workflow_table
from workers.stores.plan_store import PlanStore, Room
from workers.stores.plan_writer import PlanWriter
from workers.stores.totals import FAILURE

JOBS = workflow_table("sqlite")
LONG_AGO_MS, LATER_MS = 1_700_000_000_000, 32_000_000_000_000


def end(database: Database, plan_id: str, status: str, ended_ms: int = LATER_MS) -> None:
    """End a job as the engine does, with no word to our tables."""
    with database.engine.begin() as transaction:
        job = sa.update(JOBS).where(JOBS.c.workflow_uuid == plan_id)
        transaction.execute(job.values(status=status, updated_at=ended_ms))


def counted(store: PlanStore) -> dict[str, int]:
    return {total.label: total.count for total in store.totals() if total.name == FAILURE}


def test_jobs_that_the_engine_gave_up_or_saw_end_by_an_error_are_counted_once(
    database: Database, queue: JobQueue, store: PlanStore
) -> None:
    plans = [accept(store, task(), None, queue).id for _ in range(6)]
    statuses = ("ERROR", "MAX_RECOVERY_ATTEMPTS_EXCEEDED", "MAX_RECOVERY_ATTEMPTS_EXCEEDED", "SUCCESS", "CANCELLED")
    for plan_id, status in zip(plans, statuses, strict=False):
        end(database, plan_id, status)
    for _ in range(2):
        count_failures(store)
        assert counted(store) == {"error": 1, "interruptions": 2}
    queue.forget(plans[0])
    store.delete(plans[0])
    count_failures(store)
    assert counted(store) == {"error": 1, "interruptions": 2}


def test_a_job_that_failed_by_a_solvers_word_is_not_counted_again(
    database: Database, queue: JobQueue, store: PlanStore
) -> None:
    plan_id = accept(store, task(), None, queue).id
    assert store.mark_failed(plan_id, 0, "fault")
    end(database, plan_id, "ERROR")
    count_failures(store)
    assert counted(store) == {"fault": 1}


@pytest.mark.parametrize("ended_ms", [LONG_AGO_MS, LATER_MS], ids=["by a clock that is behind", "later"])
def test_a_plan_looks_the_same_before_and_after_it_is_counted(
    database: Database, queue: JobQueue, store: PlanStore, ended_ms: int
) -> None:
    plan_id = accept(store, task(), None, queue).id
    end(database, plan_id, "MAX_RECOVERY_ATTEMPTS_EXCEEDED", ended_ms)
    room = Room(10, 10, 10)
    desk = PlanCollection(store, queue, PlanWriter(store, queue, room), room, ANYBODY)
    before = desk.plan(plan_id)
    assert before.finished_at is not None
    count_failures(store)
    assert counted(store) == {"interruptions": 1}
    assert desk.plan(plan_id) == before
