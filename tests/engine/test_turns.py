"""Whose job is begun next: owners take turns, and priorities count among the jobs of one owner."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

import pytest
import sqlalchemy as sa
from hypothesis import given, settings
from hypothesis import strategies as st
from support.places import database_at, on_both_databases

from workers.settings import WorkerSettings
from workers.stores.database import Database, open_database
from workers.stores.job_queue import JobQueue, NewJob
from workers.stores.jobs import input_table, workflow_table

OWNERS = ("a", "b", "c", None)
POST, BEGIN, END = "post", "begin", "end"
Step = tuple[str, str | None, int]
steps = st.lists(
    st.tuples(st.sampled_from((POST, POST, BEGIN, END)), st.sampled_from(OWNERS), st.integers(0, 9)), max_size=25
)


@dataclass
class Model:
    """The rule, in so many words."""

    waiting: list[tuple[str | None, int, int, str]] = field(default_factory=list)
    """(owner, -priority, created, id) of each job."""
    running: list[tuple[str | None, str]] = field(default_factory=list)
    begun: dict[str | None, int] = field(default_factory=dict)

    def order(self) -> list[str]:
        """Return the ids of all that wait, the next to begin first."""
        busy, ahead = Counter(owner for owner, _ in self.running), Counter[str | None]()
        ranked: list[tuple[int, int, int, str]] = []
        for owner, _, created, job in sorted(self.waiting, key=lambda each: each[1:]):
            ahead[owner] += 1
            ranked.append((busy[owner] + ahead[owner], self.begun.get(owner, 0), created, job))
        return [job for *_, job in sorted(ranked)]

    def begin(self, job: str, now: int) -> None:
        """Take a job from the queue."""
        (owner,) = [each[0] for each in self.waiting if each[3] == job]
        self.waiting = [each for each in self.waiting if each[3] != job]
        self.running.append((owner, job))
        self.begun[owner] = now


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
def test_the_next_job_and_all_places_are_those_of_the_rule(queue: Queue, steps: list[Step]) -> None:
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
            queue.put(job, status="PENDING", started_at_epoch_ms=now)
        elif deed == END and model.running:
            _, job = model.running.pop(priority % len(model.running))
            queue.put(job, status="SUCCESS")
    assert queue.next() == model.order()[:1]
    places = queue.queue.places([job for *_, job in model.waiting], 1000)
    assert sorted(places, key=places.__getitem__) == model.order()
    assert sorted(places.values()) == list(range(1, len(model.waiting) + 1))


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
