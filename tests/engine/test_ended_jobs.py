"""A job that has ended stays as it is, whatever a worker says that has not learned of it yet."""

from __future__ import annotations

import threading

import pytest
import sqlalchemy as sa

from planners.study.study import Study
from planners.study.study_map import StudyPoint
from tests.support.accepted import accept
from tests.support.places import on_both_databases
from tests.support.service import task
from workers.stores.database import Database
from workers.stores.job_queue import JobQueue
from workers.stores.jobs import CANCELLED, FAILED, GIVEN_UP, RUNNING, SUCCEEDED, workflow_table
from workers.stores.plan_store import PackedDocument, PlanEvent, PlanStore
from workers.stores.study_store import StudyStore

EVENT = PlanEvent(attempt=1, stage="search", fraction=0.5)
DOCUMENT = PackedDocument("solved", "0" * 64, b"content", ())
pytestmark = on_both_databases


def tell_nobody(_: sa.Connection) -> None: ...


def in_status(database: Database, plan_id: str, status: str) -> sa.Update:
    """Return what the engine does with a job."""
    jobs = workflow_table(database.engine.dialect.name)
    return sa.update(jobs).where(jobs.c.workflow_uuid == plan_id).values(status=status)


def begun(database: Database, store: PlanStore, queue: JobQueue) -> str:
    """Return the id of a plan whose first attempt goes on."""
    plan_id = accept(store, task(), None, queue).id
    database.write(in_status(database, plan_id, RUNNING))
    assert store.begin_attempt(plan_id) is not None
    return plan_id


@pytest.mark.parametrize("ended", [CANCELLED, FAILED, GIVEN_UP, SUCCEEDED])
def test_nothing_is_written_for_a_job_that_has_ended(
    database: Database, store: PlanStore, queue: JobQueue, ended: str
) -> None:
    plan_id = begun(database, store, queue)
    store.add_event(plan_id, EVENT)
    database.write(in_status(database, plan_id, ended))
    before = store.get(plan_id), store.events_after(plan_id, 0), store.totals()
    store.add_event(plan_id, EVENT)
    store.save_certified(plan_id, DOCUMENT, EVENT, tell_nobody)
    assert not store.save_document(plan_id, 1, DOCUMENT)
    assert not store.mark_failed(plan_id, 1, "fault")
    assert store.begin_attempt(plan_id) is None
    assert (store.get(plan_id), store.events_after(plan_id, 0), store.totals()) == before
    assert store.document(plan_id) is None


def test_what_is_written_while_a_job_is_ended_waits_and_is_dropped(
    database: Database, store: PlanStore, queue: JobQueue
) -> None:
    """Otherwise it could be committed after somebody was told of the end."""
    plan_id = begun(database, store, queue)
    writing = threading.Thread(target=store.add_event, args=(plan_id, EVENT))
    with database.engine.begin() as transaction:
        transaction.execute(in_status(database, plan_id, CANCELLED))
        writing.start()
        writing.join(0.3)
        assert writing.is_alive()
    writing.join()
    assert store.events_after(plan_id, 0) == []


def test_a_job_is_not_ended_while_something_is_written_for_it(
    database: Database, store: PlanStore, queue: JobQueue
) -> None:
    plan_id = begun(database, store, queue)
    ending = threading.Thread(target=queue.cancel, args=(plan_id,))
    told: list[bool] = []

    def tell(_: sa.Connection) -> None:
        ending.start()
        ending.join(0.3)
        told.append(ending.is_alive())

    store.save_certified(plan_id, DOCUMENT, EVENT, tell)
    ending.join()
    assert told == [True]
    record = store.get(plan_id)
    assert record is not None
    assert record.outcome == "solved"


@pytest.mark.parametrize("known", [0, 1])
def test_no_point_comes_behind_the_end_of_a_study(
    database: Database, store: PlanStore, queue: JobQueue, known: int
) -> None:
    studies = StudyStore(database, store, queue)
    axes = [{"pointer": "/cup/max_force", "values": [20.0, 30.0]}]
    study = Study.read({"task": task("pb1.json"), "axes": axes})
    record = studies.accept(study, None, None, "sent")
    points = [StudyPoint.without_plan(study, index, "failed", "why", 0.0) for index in range(study.count)]
    if known:
        assert studies.begin(record.id)
        assert studies.add_point(record.id, points[0])
    studies.cancel(record)
    before = studies.get(record.id), studies.points(record.id), store.totals()
    assert not studies.add_point(record.id, points[1])
    assert studies.begin(record.id) is bool(known)
    assert (studies.get(record.id), studies.points(record.id), store.totals()) == before
    assert len(before[1]) == known
