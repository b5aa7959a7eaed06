"""The store and the queue on a database of their own."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from tests.support.accepted import accept
from tests.support.service import task
from workers.settings import WorkerSettings
from workers.stores.database import open_database
from workers.stores.job_queue import JobQueue
from workers.stores.jobs import JobState
from workers.stores.plan_store import PackedDocument, PlanEvent, PlanStore


def packed(content: bytes) -> PackedDocument:
    return PackedDocument("solved", "0" * 64, content, (("search", 0.5),))


@pytest.fixture
def desk(tmp_path: Path) -> Iterator[tuple[PlanStore, JobQueue]]:
    database = open_database(WorkerSettings(data_dir=tmp_path))
    queue = JobQueue(database)
    yield PlanStore(database), queue
    queue.close()
    database.close()


def test_an_accepted_plan_has_a_queued_job(desk: tuple[PlanStore, JobQueue]) -> None:
    store, queue = desk
    record = accept(store, task(), None, queue)
    assert store.get(record.id) == record
    assert store.task(record.id) == task()
    assert queue.jobs([record.id])[record.id].state is JobState.QUEUED


def test_one_key_makes_one_plan_however_many_ask_at_once(desk: tuple[PlanStore, JobQueue]) -> None:
    store, queue = desk
    with ThreadPoolExecutor(8) as pool:
        records = list(pool.map(lambda _: accept(store, task(), "key", queue), range(16)))
    assert len({record.id for record in records}) == 1
    assert queue.depth(100).due == 1


def test_pages_hold_every_plan_once(desk: tuple[PlanStore, JobQueue]) -> None:
    store, queue = desk
    made = {accept(store, task(), None, queue).id for _ in range(11)}
    seen: list[str] = []
    before = None
    while page := store.newest(3, before):
        seen += [record.id for record in page]
        before = (page[-1].created_us, page[-1].id)
    assert sorted(seen) == sorted(made)


def test_events_are_numbered_from_one_and_shown_as_progress(desk: tuple[PlanStore, JobQueue]) -> None:
    store, queue = desk
    plan_id = accept(store, task(), None, queue).id
    for fraction in (0.1, 0.2, 0.3):
        store.add_event(plan_id, PlanEvent(attempt=0, stage="search", fraction=fraction))
    assert [number for number, _ in store.events_after(plan_id, 0)] == [1, 2, 3]
    assert [event["fraction"] for _, event in store.events_after(plan_id, 1)] == [0.2, 0.3]
    record = store.get(plan_id)
    assert record is not None
    assert (record.stage, record.fraction) == ("search", 0.3)


def test_what_is_written_for_a_deleted_plan_is_dropped(desk: tuple[PlanStore, JobQueue]) -> None:
    store, queue = desk
    plan_id = accept(store, task(), None, queue).id
    store.save_document(plan_id, 0, packed(b"first"))
    store.delete(plan_id)
    store.add_event(plan_id, PlanEvent(attempt=0, stage="search", fraction=0.5))
    store.save_document(plan_id, 0, packed(b"first"))
    assert store.get(plan_id) is None
    assert store.events_after(plan_id, 0) == []
    assert store.document(plan_id) is None
    assert store.outcome_counts() == {}


def test_a_later_document_replaces_an_earlier_one(desk: tuple[PlanStore, JobQueue]) -> None:
    store, queue = desk
    plan_id = accept(store, task(), None, queue).id
    for content in (b"first", b"second"):
        assert store.save_document(plan_id, 0, packed(content))
    document = store.document(plan_id)
    assert document is not None
    assert document.gzip == b"second"
