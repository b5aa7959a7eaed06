"""Jobs whose time is over are cancelled, whoever has them; those that have ended are let be."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest
import sqlalchemy as sa

from tests.support.accepted import accept
from tests.support.service import task
from workers.engine.housekeeping import BATCH, cancel_overdue
from workers.settings import WorkerSettings
from workers.stores.database import Database, open_database
from workers.stores.job_queue import JobQueue
from workers.stores.jobs import JobOrder, JobState, workflow_table
from workers.stores.plan_store import PlanStore
from workers.stores.tables import now_us

HOUR_US = 3_600_000_000


@dataclass(frozen=True)
class Stores:
    database: Database
    store: PlanStore
    queue: JobQueue

    def accept(self, end_in_us: int | None, start_in_us: int | None = None) -> str:
        now = now_us()
        times = [None if each is None else now + each for each in (start_in_us, end_in_us)]
        order = JobOrder(start_us=times[0], end_us=times[1])
        return accept(self.store, task(), None, self.queue, order=order).id

    def become(self, plan_id: str, status: str) -> None:
        jobs = workflow_table("sqlite")
        with self.database.engine.begin() as transaction:
            changed = sa.update(jobs).where(jobs.c.workflow_uuid == plan_id)
            transaction.execute(changed.values(status=status, executor_id="worker"))

    def state(self, plan_id: str) -> JobState:
        return self.queue.jobs([plan_id])[plan_id].state

    def sweep(self) -> None:
        cancel_overdue(self.store, self.queue)


@pytest.fixture
def stores(tmp_path: Path) -> Iterator[Stores]:
    database = open_database(WorkerSettings(data_dir=tmp_path))
    queue = JobQueue(database)
    yield Stores(database, PlanStore(database), queue)
    queue.close()
    database.close()


def test_only_what_is_overdue_is_cancelled_queued_delayed_or_running(stores: Stores) -> None:
    waiting, running = stores.accept(-1), stores.accept(-1)
    delayed = stores.accept(-1, start_in_us=HOUR_US)
    kept = [stores.accept(None), stores.accept(HOUR_US)]
    stores.become(running, "PENDING")
    stores.sweep()
    for plan_id in (waiting, running, delayed):
        record = stores.store.get(plan_id)
        assert stores.state(plan_id) is JobState.CANCELLED
        assert record is not None
        assert record.end_us is not None
        assert record.finished_us is not None
        assert record.finished_us >= record.end_us
    assert [stores.state(plan_id) for plan_id in kept] == [JobState.QUEUED] * 2


@pytest.mark.parametrize("status", ["SUCCESS", "ERROR", "CANCELLED"])
def test_what_has_ended_before_stays_as_it_is(stores: Stores, status: str) -> None:
    plan_id = stores.accept(-1)
    stores.become(plan_id, status)
    before = stores.store.get(plan_id)
    stores.sweep()
    assert stores.store.get(plan_id) == before


def test_more_than_a_batch_is_cancelled(stores: Stores) -> None:
    plans = [stores.accept(-1) for _ in range(BATCH + 1)]
    stores.sweep()
    stores.sweep()
    assert {job.state for job in stores.queue.jobs(plans).values()} == {JobState.CANCELLED}


def test_an_end_that_was_seen_stays(stores: Stores) -> None:
    plan_id = stores.accept(-1)
    stores.sweep()
    before = stores.store.get(plan_id)
    stores.store.mark_overdue([plan_id])
    assert stores.store.get(plan_id) == before
