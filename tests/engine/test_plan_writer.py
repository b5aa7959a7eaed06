"""Many plans in one transaction are what each would be alone, and nobody is answered before it."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from itertools import chain
from pathlib import Path

import pytest
import sqlalchemy as sa
from dbos import DBOSClient, EnqueueOptions, WorkflowSerializationFormat
from sqlalchemy.exc import OperationalError

from app.access.audit_log import AuditLog, audit_row
from app.access.caller import ANYBODY
from tests.support.postgres import needs_postgres, running_postgres
from tests.support.service import task
from workers.settings import WorkerSettings
from workers.stores.database import Database, open_database
from workers.stores.job_queue import APPLICATION, APPLICATION_VERSION, QUEUE, WORKFLOW, JobQueue
from workers.stores.jobs import HIGHEST_PRIORITY, JobOrder
from workers.stores.plan_store import Accepted, NoRoom, PlanStore, Room, Submission
from workers.stores.plan_writer import PlanWriter
from workers.stores.tables import PLANS, now_us

ROOM = Room(jobs=1000, jobs_of_owner=1000, delayed=10)
HOUR_US = 3_600_000_000


@pytest.fixture(params=["sqlite", pytest.param("postgresql", marks=needs_postgres)])
def either(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Database]:
    """A database of each kind."""
    with ExitStack() as stack:
        url = stack.enter_context(running_postgres()).url if request.param == "postgresql" else None
        database = open_database(WorkerSettings(data_dir=tmp_path, database_url=url))
        stack.callback(database.close)
        yield database


def submission(key: str | None = None, order: JobOrder | None = None) -> Submission:
    return Submission.of(
        task(), "mes", order or JobOrder(), key, audit=lambda plan: audit_row(ANYBODY, "::1", "POST", plan, 202)
    )


def test_a_job_stands_in_the_queue_as_if_the_engine_had_put_it_there(either: Database) -> None:
    queue, store = JobQueue(either), PlanStore(either)
    engine = DBOSClient(system_database_url=either.engine_url, application_name=APPLICATION)
    for priority, later in ((0, None), (HIGHEST_PRIORITY, None), (3, now_us() + HOUR_US)):
        (accepted,) = store.accept_all([submission(None, JobOrder(priority=priority, start_us=later))], queue)
        assert isinstance(accepted, Accepted)
        ours = accepted.record.id
        options: EnqueueOptions = {
            "workflow_name": WORKFLOW,
            "queue_name": QUEUE,
            "app_version": APPLICATION_VERSION,
            "serialization_type": WorkflowSerializationFormat.PORTABLE,
            "priority": 1 + HIGHEST_PRIORITY - priority,
            "queue_partition_key": accepted.record.owner or "",
        }
        if later is not None:
            options["delay_seconds"] = (later - now_us()) / 1e6
        with either.engine.begin() as transaction:
            theirs = engine.enqueue_in_transaction(transaction, options, ours).workflow_id
        own, other = (vars(engine.list_workflows(workflow_ids=[each])[0]) for each in (ours, theirs))
        # The engine knows the time on SQLite to the second only.
        times = {name for name in own if name in ("created_at", "updated_at", "delay_until_epoch_ms")}
        for name in own.keys() - times - {"workflow_id"}:
            assert own[name] == other[name], name
        for name in times:
            assert (own[name] is None) == (other[name] is None), name
            assert own[name] is None or abs(own[name] - other[name]) < 5000, name
    engine.destroy()
    queue.close()


def test_each_key_makes_one_plan_however_many_processes_are_asked_at_once(either: Database) -> None:
    queue, store = JobQueue(either), PlanStore(either)
    # Two writers are what two API processes have.
    writers = [PlanWriter(store, queue, ROOM) for _ in range(2)]
    keys = [f"key {number % 7}" for number in range(140)]

    def submit(number: int) -> Accepted | NoRoom:
        return writers[number % 2].submit(submission(keys[number])).result(60.0)

    with ThreadPoolExecutor(20) as pool:
        answers = list(pool.map(submit, range(len(keys))))
    made: dict[str, set[str]] = {}
    for key, answer in zip(keys, answers, strict=True):
        assert isinstance(answer, Accepted)
        made.setdefault(key, set()).add(answer.record.id)
    plans = list(chain.from_iterable(made.values()))
    assert len(plans) == len(made) == len(set(plans)) == 7
    assert sum(answer.is_new for answer in answers if isinstance(answer, Accepted)) == 7
    assert sorted(queue.jobs(plans)) == sorted(plans) == sorted(either.column(sa.select(PLANS.c.id)))
    assert sorted(entry.target for entry in AuditLog(either).newest(100, None)) == sorted(plans)
    for writer in writers:
        writer.close()
    queue.close()


def test_processes_that_store_the_same_keys_in_opposite_orders_do_not_wait_for_each_other(either: Database) -> None:
    queue, store = JobQueue(either), PlanStore(either)
    rounds, keys = 12, 30
    together = threading.Barrier(2)

    def accept(*, turned: bool) -> list[Accepted | NoRoom]:
        answers: list[Accepted | NoRoom] = []
        for number in range(rounds):
            wanted = [submission(f"{number} {key}") for key in range(keys)]
            together.wait(30.0)
            answers += store.accept_all(wanted[::-1] if turned else wanted, queue, ROOM)
        return answers

    with ThreadPoolExecutor(2) as pool:
        one, other = (pool.submit(accept, turned=turned) for turned in (False, True))
        answers = [*one.result(), *other.result()]
    assert all(isinstance(answer, Accepted) for answer in answers)
    assert len(either.column(sa.select(PLANS.c.id))) == rounds * keys
    queue.close()


def test_what_is_answered_is_what_a_later_look_shows(either: Database) -> None:
    queue, store = JobQueue(either), PlanStore(either)
    orders = [JobOrder(), JobOrder(priority=5), JobOrder(), JobOrder(start_us=now_us() + HOUR_US), JobOrder()]
    answers = store.accept_all([submission(None, order) for order in orders], queue, ROOM)
    for answer in answers:
        assert isinstance(answer, Accepted)
        assert store.get(answer.record.id) == answer.record
    plans = [answer.record.id for answer in answers if isinstance(answer, Accepted)]
    places = queue.places(plans, 100)
    assert [answer.place for answer in answers if isinstance(answer, Accepted)] == [places.get(plan) for plan in plans]
    assert places[plans[1]] == 1
    assert sorted(places.values()) == [1, 2, 3, 4]
    assert plans[3] not in places
    queue.close()


def test_texts_that_databases_write_in_other_ways_are_stored_as_they_are(either: Database) -> None:
    queue, store = JobQueue(either), PlanStore(either)
    names = [
        None,
        "",
        "NULL",
        "null",
        "{a,b}",
        '"',
        "\\",
        "'",
        ",",
        " x ",
        "ä\N{GRINNING FACE}\n",
        "with \0",
        "%s %(id)s :id",
    ]
    submissions = [Submission.of(task(external_id=name), None, JobOrder(work_master=name)) for name in names]
    store.accept_all(submissions, queue)
    assert [store.get(each.plan_id) for each in submissions] == [each.record for each in submissions]
    assert [(store.task(each.plan_id) or {})["external_id"] for each in submissions] == names
    queue.close()


def test_there_is_room_for_so_many_jobs_and_no_more_also_among_those_that_come_at_once(
    database: Database, store: PlanStore, queue: JobQueue
) -> None:
    room = Room(jobs=5, jobs_of_owner=5, delayed=2)
    later = JobOrder(start_us=now_us() + HOUR_US)
    first = store.accept_all([submission(None, order) for order in (later, later, later, JobOrder())], queue, room)
    assert [answer is NoRoom.TOO_MANY_DELAYED for answer in first] == [False, False, True, False]
    second = store.accept_all([submission() for _ in range(6)], queue, room)
    assert [answer is NoRoom.QUEUE_FULL for answer in second] == [False] * 4 + [True] * 2
    assert len(database.column(sa.select(PLANS.c.id))) == len(AuditLog(database).newest(100, None)) == 7


def test_a_plan_that_cannot_be_stored_leaves_no_job_and_no_entry(
    database: Database, store: PlanStore, queue: JobQueue, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(transaction: sa.Connection, plans: object) -> None:
        raise OperationalError("", {}, Exception("the disk is full"))

    monkeypatch.setattr("workers.stores.plan_store.expect_deliveries", fail)
    writer = PlanWriter(store, queue, ROOM)
    with pytest.raises(OperationalError):
        writer.submit(submission()).result(60.0)
    monkeypatch.undo()
    assert queue.depth(100).due == 0
    assert AuditLog(database).newest(100, None) == []
    answer = writer.submit(submission()).result(60.0)
    assert isinstance(answer, Accepted)
    writer.close()
    assert queue.depth(100).due == 1
