"""Whose job is begun next: owners take turns, and priorities count among the jobs of one owner."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

import httpx
import pytest
import sqlalchemy as sa
from hypothesis import given, settings
from hypothesis import strategies as st

from app.access.caller import Scope
from app.cli.keys_command import issue_key
from app.settings import ServiceSettings
from tests.support.places import database_at, on_both_databases
from tests.support.service import FAKE_EXAMINER, FAKE_SOLVER, finished, task, wait_for
from tests.support.serving import served
from workers.settings import WorkerSettings
from workers.stores.database import Database, open_database
from workers.stores.job_queue import PUT_OFF_SECONDS, JobQueue, NewJob
from workers.stores.jobs import JobState, input_table, workflow_table
from workers.stores.tables import PLANS

WORKER = "worker"
OWNERS = ("a", "b", "c", None)
POST, BEGIN, PUT_OFF, END = "post", "begin", "put off", "end"
LATER = 100
Step = tuple[str, str | None, int]
steps = st.lists(
    st.tuples(st.sampled_from((POST, POST, BEGIN, BEGIN, PUT_OFF, END)), st.sampled_from(OWNERS), st.integers(0, 9)),
    max_size=25,
)


@dataclass
class Model:
    """The rule, in so many words."""

    waiting: list[tuple[str | None, int, int, str]] = field(default_factory=list)
    """(owner, -priority, created, id) of each job; `LATER` is added to the second of those that are put off."""
    running: list[tuple[str | None, int, int, str]] = field(default_factory=list)
    begun: dict[str | None, int] = field(default_factory=dict)

    def order(self) -> list[str]:
        """Return the ids of all that wait, the next to begin first."""
        busy, ahead = Counter(owner for owner, *_ in self.running), Counter[str | None]()
        ranked: list[tuple[bool, int, int, int, str]] = []
        for owner, urgency, created, job in sorted(self.waiting, key=lambda each: each[1:]):
            ahead[owner] += 1
            ranked.append((urgency > 0, busy[owner] + ahead[owner], self.begun.get(owner, 0), created, job))
        return [job for *_, job in sorted(ranked)]

    def begin(self, job: str, now: int) -> None:
        """Take a job from the queue."""
        (begun,) = [each for each in self.waiting if each[3] == job]
        self.waiting.remove(begun)
        self.running.append(begun)
        self.begun[begun[0]] = now

    def put_off(self, number: int) -> str:
        """Put a job that runs back into the queue, behind all others, and return its id."""
        owner, urgency, created, job = self.running.pop(number)
        self.waiting.append((owner, urgency if urgency > 0 else urgency + LATER, created, job))
        return job


class Queue:
    """The queue of a database, with what the engine would do to it."""

    def __init__(self, database: Database) -> None:
        self.database, self.queue = database, JobQueue(database)
        self.jobs = workflow_table(database.engine.dialect.name)
        self.inputs = input_table(database.engine.dialect.name)

    def clear(self) -> None:
        for table in (self.inputs, self.jobs):
            self.database.write(sa.delete(table))

    def post(self, job: str, owner: str | None, priority: int, now: int) -> None:
        with self.database.engine.begin() as transaction:
            self.queue.enqueue(transaction, [NewJob(job, now * 1000, owner, priority)])

    def next(self) -> list[str]:
        job = self.jobs.c.workflow_uuid
        return self.database.column(sa.select(job).where(self.queue.is_next(job)))

    def put(self, job: str, **values: object) -> None:
        self.database.write(sa.update(self.jobs).where(self.jobs.c.workflow_uuid == job).values(**values))


@pytest.fixture(scope="module")
def place(request: pytest.FixtureRequest) -> Iterator[dict[str, str]]:
    with database_at(getattr(request, "param", "sqlite")) as place:
        yield place


@pytest.fixture(scope="module")
def queue(tmp_path_factory: pytest.TempPathFactory, place: dict[str, str]) -> Iterator[Queue]:
    data_dir: Path = tmp_path_factory.mktemp("data")
    settings = WorkerSettings.model_validate({"data_dir": data_dir, **place})
    with closing(open_database(settings)) as database:
        queue = Queue(database)
        yield queue
        queue.queue.close()


@on_both_databases
@settings(max_examples=40, deadline=None)
@given(steps=steps)
@pytest.mark.slow
def test_the_next_job_and_all_places_are_those_of_the_rule(queue: Queue, steps: list[Step]) -> None:
    model = lived_through(queue, steps)
    assert queue.next() == model.order()[:1]
    places = queue.queue.places([job for *_, job in model.waiting], 1000)
    assert sorted(places, key=places.__getitem__) == model.order()
    assert sorted(places.values()) == list(range(1, len(model.waiting) + 1))
    assert queue.queue.another_waits() == any(urgency <= 0 for _, urgency, *_ in model.waiting)
    states = {each: job.state for each, job in queue.queue.jobs([job for *_, job in model.waiting]).items()}
    assert states == {job: JobState.RUNNING if urgency > 0 else JobState.QUEUED for _, urgency, _, job in model.waiting}


@on_both_databases
@settings(max_examples=40, deadline=None)
@given(
    steps=steps,
    long_ago=st.booleans(),
    joining=st.lists(st.tuples(st.sampled_from(OWNERS), st.integers(0, 9), st.integers(0, 1)), max_size=6),
)
def test_jobs_that_join_the_queue_are_told_the_places_that_they_have_in_it(
    queue: Queue, steps: list[Step], long_ago: bool, joining: list[tuple[str | None, int, int]]
) -> None:
    model = lived_through(queue, steps)
    if long_ago:
        queue.database.write(sa.update(queue.jobs).values(updated_at=0))
    new = [
        NewJob(f"new {number}", (len(steps) + 1 + later) * 1000, owner, priority)
        for number, (owner, priority, later) in enumerate(joining)
    ]
    with queue.database.engine.begin() as transaction:
        due = queue.queue.due(transaction)
        if new:
            queue.queue.enqueue(transaction, new)
    assert due.places(new) == queue.queue.places([job.plan_id for job in new], 1000)
    owners = Counter(owner for owner, *_ in (*model.waiting, *model.running))
    assert due.of_owners() == owners


def lived_through(queue: Queue, steps: list[Step]) -> Model:
    """Have a queue that was empty go through what happens, the model beside it."""
    queue.clear()
    model = Model()
    for now, (deed, owner, priority) in enumerate(steps, 1):
        if deed == POST:
            model.waiting.append((owner, -priority, now, f"job {now}"))
            queue.post(f"job {now}", owner, priority, now)
        elif deed == BEGIN and model.waiting:
            (job,) = queue.next()
            assert job == model.order()[0]
            model.begin(job, now)
            queue.put(job, status="PENDING", started_at_epoch_ms=now, executor_id=WORKER)
        elif deed == PUT_OFF and model.running:
            job = model.put_off(priority % len(model.running))
            queue.queue.put_off("another worker", job)
            assert job not in queue.queue.places([job], 1000)
            queue.queue.put_off(WORKER, job)
        elif deed == END and model.running:
            *_, job = model.running.pop(priority % len(model.running))
            queue.put(job, status="SUCCESS")
    return model


def test_a_job_that_is_put_off_comes_after_all_others_but_does_not_wait_for_ever(queue: Queue) -> None:
    queue.clear()
    queue.post("put off", "a", 9, 1)
    queue.put("put off", status="PENDING", executor_id=WORKER)
    queue.queue.put_off(WORKER, "put off")
    queue.post("new", "a", 0, 2)
    assert queue.next() == ["new"]
    queue.put("new", status="PENDING", executor_id=WORKER)
    queue.post("newer", "b", 0, 3)
    assert queue.next() == ["newer"]
    queue.put("new", status="SUCCESS")
    long_ago = round(1e3 * (time.time() - PUT_OFF_SECONDS))
    queue.put("put off", updated_at=long_ago)
    assert queue.next() == ["put off"]


def test_a_job_that_was_put_off_long_enough_is_among_its_owners_jobs_as_it_was_before(queue: Queue) -> None:
    queue.clear()
    for number, (job, priority) in enumerate({"urgent": 9, "usual": 5}.items()):
        queue.post(job, "a", priority, number)
        queue.put(job, status="PENDING", executor_id=WORKER)
        queue.queue.put_off(WORKER, job)
    for number, (job, priority) in enumerate({"as urgent, later": 9, "as usual, later": 5, "last": 0}.items()):
        queue.post(job, "a", priority, 10 + number)
    long_ago = round(1e3 * (time.time() - PUT_OFF_SECONDS))
    for job in ("urgent", "usual"):
        queue.put(job, updated_at=long_ago)
    begun = list[str]()
    for _ in range(5):
        (job,) = queue.next()
        queue.put(job, status="SUCCESS")
        begun.append(job)
    assert begun == ["urgent", "as urgent, later", "usual", "as usual, later", "last"]


def test_whoever_tops_up_at_the_highest_priority_has_every_second_turn_and_no_more(queue: Queue) -> None:
    """One worker with one slot: nothing runs when it looks for the next job."""
    queue.clear()
    for number in range(6):
        queue.post(f"patient {number}", "patient", 0, 100 + number)
    begun = list[str]()
    for now in range(200, 212):
        queue.post(f"greedy {now}", "greedy", 9, now)
        (job,) = queue.next()
        queue.put(job, status="PENDING", started_at_epoch_ms=now)
        queue.put(job, status="SUCCESS")
        begun.append(job.split()[0])
    assert Counter(begun) == {"patient": 6, "greedy": 6}
    assert all(first != second for first, second in pairwise(begun))


def test_the_next_of_many_jobs_is_found_by_indexes_on_sqlite(queue: Queue) -> None:
    queue.clear()
    job = queue.jobs.c.workflow_uuid
    query = sa.select(job).where(queue.queue.is_next(job))
    text = str(query.compile(queue.database.engine, compile_kwargs={"literal_binds": True}))
    with queue.database.engine.connect() as connection:
        plan = [row.detail for row in connection.exec_driver_sql(f"EXPLAIN QUERY PLAN {text}")]
    assert not [step for step in plan if step.startswith("SCAN workflow_status")], plan
    assert not [step for step in plan if step.startswith("SCAN begun") and "INDEX" not in step], plan


@pytest.mark.slow
def test_owners_take_turns_within_a_second_too(tmp_path: Path) -> None:
    """On SQLite the engine itself notes only in which second it has begun a job."""
    service = ServiceSettings(
        data_dir=tmp_path, solver_command=FAKE_SOLVER, study_command=FAKE_EXAMINER, worker_slots=1, poll_seconds=0.02
    )
    keys = {owner: issue_key(service, owner, Scope.WRITE, None) for owner in ("many", "few")}
    with served(service) as address:
        clients = {
            owner: httpx.Client(base_url=address, headers={"Authorization": f"Bearer {key}"}, timeout=30.0)
            for owner, key in keys.items()
        }
        with clients["many"] as many, clients["few"] as few:
            first = many.post("/v1/plans", json=task(external_id="steps-40")).json()
            wait_for(lambda: many.get(first["links"]["self"]).json()["state"] == "running")
            plans = [many.post("/v1/plans", json=task(external_id="steps-1")).json() for _ in range(8)]
            plans += [few.post("/v1/plans", json=task(external_id="steps-1")).json() for _ in range(5)]
            for plan in plans:
                finished(many if plan in plans[:8] else few, plan)
    with closing(open_database(service)) as database:
        begun = database.column(sa.select(PLANS.c.owner).order_by(PLANS.c.started_us))
    assert begun == ["many", *["few", "many"] * 5, *["many"] * 3]
