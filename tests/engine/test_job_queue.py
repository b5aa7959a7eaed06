"""Whose a job is, and how it changes hands."""

from __future__ import annotations

import re

import sqlalchemy as sa

from tests.support.accepted import accept
from tests.support.service import task
from workers.stores.database import Database
from workers.stores.job_queue import APPLICATION_VERSION, Depth, JobQueue
from workers.stores.jobs import JobOrder, workflow_table
from workers.stores.plan_store import PackedDocument, PlanEvent, PlanStore
from workers.stores.tables import now_us
from workers.stores.totals import DOCUMENT, STAGE, TAKEOVER

JOBS = workflow_table("sqlite")
DOCUMENT_MADE = PackedDocument("solved", "0" * 64, b"first", (("search", 0.5), ("certify", 0.25)))


def begin(database: Database, plan_id: str, worker: str) -> None:
    """Hand a job to a worker, as the engine does."""
    with database.engine.begin() as transaction:
        begun = sa.update(JOBS).where(JOBS.c.workflow_uuid == plan_id)
        transaction.execute(begun.values(status="PENDING", executor_id=worker, owner_xid="x"))


def test_depth_counts_waiting_and_running_jobs_up_to_the_limit(
    database: Database, store: PlanStore, queue: JobQueue
) -> None:
    plans = [accept(store, task(), None, queue).id for _ in range(5)]
    begin(database, plans[0], "a")
    queue.cancel(plans[1])
    depth = queue.depth(100)
    assert (depth.queued, depth.running, depth.due) == (3, 1, 4)
    assert queue.depth(2).queued == 2


def test_jobs_that_wait_for_their_start_are_counted_apart(store: PlanStore, queue: JobQueue) -> None:
    later = JobOrder(start_us=now_us() + 3_600_000_000)
    for order in (later, later, JobOrder(), JobOrder(start_us=1)):
        accept(store, task(), None, queue, "mes", order)
    assert queue.depth(100) == Depth(queued=2, delayed=2, running=0)
    assert queue.depth(100).due == 2
    assert [store.delayed(owner, 100) for owner in ("mes", "other", None)] == [2, 0, 0]
    assert store.delayed("mes", 1) == 1


def test_a_job_is_of_the_pinned_version_so_that_workers_of_the_next_release_take_it(
    database: Database, store: PlanStore, queue: JobQueue
) -> None:
    accept(store, task(), None, queue)
    with database.engine.connect() as connection:
        versions = connection.exec_driver_sql("SELECT application_version FROM workflow_status").scalars().all()
    assert versions == [APPLICATION_VERSION]
    assert not re.search(r"[0-9a-f]{8}", APPLICATION_VERSION), "no hash of the code"


def test_jobs_of_a_dead_worker_are_begun_anew_once_and_those_of_others_are_not(
    database: Database, store: PlanStore, queue: JobQueue
) -> None:
    lost, live = (accept(store, task(), None, queue).id for _ in range(2))
    begin(database, lost, "dead")
    begin(database, live, "alive")
    assert queue.running() == {"dead": {lost}, "alive": {live}}
    assert [queue.begin_anew("dead", [lost, live]) for _ in range(2)] == [1, 0]
    assert queue.running() == {"alive": {live}}
    assert queue.not_with("dead", [lost]) == {lost}
    assert queue.not_with("alive", [live]) == set()
    assert queue.not_with("dead", [live]) == {live}
    assert {(total.name, total.count) for total in store.totals()} == {(TAKEOVER, 1)}


def test_what_an_earlier_attempt_still_writes_is_dropped(store: PlanStore, queue: JobQueue) -> None:
    plan_id = accept(store, task(), None, queue).id
    first, second = store.begin_attempt(plan_id), store.begin_attempt(plan_id)
    assert first is not None
    assert second is not None
    assert (first.attempts, second.attempts) == (1, 2)
    store.add_event(plan_id, PlanEvent(attempt=2, stage="search", fraction=0.5))
    store.add_event(plan_id, PlanEvent(attempt=1, stage="scene", fraction=0.1))
    assert len(store.events_after(plan_id, 0)) == 1
    assert not store.save_document(plan_id, 1, DOCUMENT_MADE)
    assert not store.mark_failed(plan_id, 1, "time")
    assert store.outcome(plan_id) is None
    assert store.save_document(plan_id, 2, DOCUMENT_MADE)
    record = store.get(plan_id)
    assert record is not None
    assert (record.fraction, record.outcome) == (0.5, "solved")


def test_a_document_that_is_stored_twice_is_counted_once_with_its_stages(store: PlanStore, queue: JobQueue) -> None:
    plan_id = accept(store, task(), None, queue).id
    for _ in range(2):
        store.save_document(plan_id, 0, DOCUMENT_MADE)
    totals = {(total.name, total.label): (total.count, total.seconds) for total in store.totals()}
    assert totals == {(DOCUMENT, "solved"): (1, 0.0), (STAGE, "search"): (1, 0.5), (STAGE, "certify"): (1, 0.25)}
