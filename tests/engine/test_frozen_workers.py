"""A worker that is frozen holds its name and does nothing: others find out, and it stops long before they do."""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path
from typing import Any, cast

import pytest
import sqlalchemy as sa
from pydantic import ValidationError

from tests.support.accepted import accept
from tests.support.postgres import needs_postgres, running_postgres
from tests.support.service import task, wait_for
from workers.engine.deadline import PatientQuestion
from workers.engine.executor_lock import AdvisoryLock, worker_lives
from workers.engine.takeover import BEGINNING_SECONDS, Takeover
from workers.settings import WorkerSettings
from workers.stores.database import Database, open_database
from workers.stores.job_queue import JobQueue
from workers.stores.jobs import workflow_table
from workers.stores.plan_store import PlanStore
from workers.stores.totals import TAKEOVER, add_to_total

SOON = {"watch_seconds": 0.1, "patience_seconds": 0.3, "frozen_seconds": 1.0}


@needs_postgres
@pytest.mark.slow
def test_jobs_of_a_frozen_worker_are_taken_over_and_it_learns_of_that(tmp_path: Path) -> None:
    with running_postgres() as server, ExitStack() as to_close:
        settings = {
            name: WorkerSettings.model_validate(
                {"data_dir": tmp_path, "database_url": server.url, "worker_name": name, **SOON}
            )
            for name in ("frozen", "well")
        }
        database = to_close.enter_context(closing(open_database(settings["well"])))
        queue = to_close.enter_context(closing(JobQueue(database)))
        frozen, well = (
            Takeover(each, queue, AdvisoryLock(database, name), frozenset, list) for name, each in settings.items()
        )

        async def run() -> None:
            for fleet in (frozen, well):
                await fleet.start()
                to_close.callback(fleet.stop)
            plan = accept(PlanStore(database), task(), None, queue).id
            hand_over(database, plan, "frozen")
            await well.look()
            await well.look()
            assert worker_lives(settings["frozen"])
            assert queue.running() == {"frozen": {plan}}
            deadline = time.monotonic() + 10.0
            while queue.running() and time.monotonic() < deadline:
                await asyncio.sleep(0.1)
                await well.look()
            assert queue.running() == {}
            assert frozen.alone, "it stops its jobs before others begin them"
            assert not worker_lives(settings["frozen"])
            assert worker_lives(settings["well"])
            # It thaws, finds its connection ended, and takes its name again.
            await frozen.look()
            assert frozen.alone
            await frozen.look()
            assert not frozen.alone
            assert worker_lives(settings["frozen"])

        asyncio.run(run())


@needs_postgres
@pytest.mark.slow
def test_a_worker_that_nobody_is_there_to_look_after_is_not_well_once_it_is_frozen(tmp_path: Path) -> None:
    with running_postgres() as server, ExitStack() as to_close:
        settings = WorkerSettings.model_validate(
            {"data_dir": tmp_path, "database_url": server.url, "worker_name": "only", **SOON}
        )
        database = to_close.enter_context(closing(open_database(settings)))
        lock = to_close.enter_context(closing(AdvisoryLock(database, "only")))
        assert lock.hold()
        assert worker_lives(settings)
        wait_for(lambda: not worker_lives(settings), 10.0)
        assert lock.hold(), "nobody has ended its session: it goes on"
        assert worker_lives(settings)


@needs_postgres
@pytest.mark.slow
def test_a_look_asks_no_more_where_many_work_than_where_few_do(tmp_path: Path) -> None:
    with running_postgres() as server, ExitStack() as to_close:
        settings = WorkerSettings.model_validate(
            {"data_dir": tmp_path, "database_url": server.url, "worker_name": "looks"}
        )
        database = to_close.enter_context(closing(open_database(settings)))
        queue = to_close.enter_context(closing(JobQueue(database)))
        looking = AdvisoryLock(database, "looks")
        takeover = Takeover(settings, queue, looking, frozenset, list)

        async def run() -> list[int]:
            await takeover.start()
            to_close.callback(takeover.stop)
            asked = []
            for number in range(4):
                assert to_close.enter_context(closing(AdvisoryLock(database, f"other {number}"))).hold()
                hand_over(database, accept(PlanStore(database), task(), None, queue).id, f"other {number}")
                with counted(looking) as statements:
                    await takeover.look()
                asked.append(len(statements))
                assert len(queue.running()) == number + 1
            return asked

        few, *_, many = asyncio.run(run())
        assert many == few


@needs_postgres
@pytest.mark.slow
def test_a_job_that_a_frozen_worker_was_writing_holds_up_nobody_who_takes_over_the_others(tmp_path: Path) -> None:
    with running_postgres() as server, ExitStack() as to_close:
        settings = WorkerSettings.model_validate({"data_dir": tmp_path, "database_url": server.url})
        database = to_close.enter_context(closing(open_database(settings)))
        queue = to_close.enter_context(closing(JobQueue(database)))
        written, other = (accept(PlanStore(database), task(), None, queue).id for _ in range(2))
        for plan in (written, other):
            hand_over(database, plan, "frozen")
        jobs = workflow_table(database.engine.dialect.name)
        with database.engine.begin() as frozen:
            frozen.execute(jobs.update().where(jobs.c.workflow_uuid == written).values(updated_at=1))
            assert queue.begin_anew("frozen", [written, other]) == 1
            assert queue.running() == {"frozen": {written}}
        with database.engine.begin() as counting:
            add_to_total(counting, TAKEOVER)
            assert queue.begin_anew("frozen", [written, other]) == 0
            assert queue.running() == {"frozen": {written}}
        assert queue.begin_anew("frozen", [written, other]) == 1
        assert queue.running() == {}


@contextmanager
def counted(lock: AdvisoryLock) -> Iterator[list[str]]:
    """Have what is asked on a lock's connection noted for the time of a block."""
    statements = list[str]()

    def note(_connection: object, _cursor: object, statement: str, *_: object) -> None:
        statements.append(statement)

    sa.event.listen(lock._engine, "before_cursor_execute", note)
    try:
        yield statements
    finally:
        sa.event.remove(lock._engine, "before_cursor_execute", note)


def hand_over(database: Database, plan: str, worker: str) -> None:
    """Hand a job to a worker, as the engine does."""
    jobs = workflow_table(database.engine.dialect.name)
    begun = jobs.update().where(jobs.c.workflow_uuid == plan)
    database.write(begun.values(status="PENDING", executor_id=worker, owner_xid="x"))


class HangingLock:
    """Stands for a lock on a server that was frozen after the name was taken."""

    def __init__(self) -> None:
        self.frozen = False
        self.thawed = threading.Event()

    def hold(self) -> bool:
        assert not self.frozen or self.thawed.wait(20)
        return True

    hold_at_start = hold

    def show_stuck(self, *, stuck: bool) -> None:
        pass

    def close(self) -> None:
        pass


class NoJobs:
    """Stands for an empty queue."""

    def running(self) -> dict[str, set[str]]:
        return {}

    def begin_anew(self, worker: str, plan_ids: Any) -> int:
        return 0


def test_a_worker_whose_database_hangs_knows_without_asking_it_that_it_is_alone(tmp_path: Path) -> None:
    settings = WorkerSettings.model_validate({"data_dir": tmp_path, **SOON})
    lock = HangingLock()
    fleet = Takeover(settings, cast(JobQueue, NoJobs()), cast(AdvisoryLock, lock), frozenset, list)

    async def run() -> None:
        await fleet.start()
        await fleet.look()
        lock.frozen = True
        looking = asyncio.create_task(fleet.look())
        await asyncio.sleep(0.1)
        assert not fleet.alone
        begun = time.monotonic()
        while not fleet.alone:
            assert time.monotonic() - begun < 5.0
            await asyncio.sleep(0.02)
        assert not looking.done()
        lock.frozen = False
        lock.thawed.set()
        await looking
        await fleet.look()
        assert not fleet.alone

    asyncio.run(run())


class HandedJobs:
    """Stands for a queue that has handed jobs to a worker."""

    def __init__(self, worker: str, *jobs: str) -> None:
        self._worker, self.handed, self.begun_anew = worker, set(jobs), list[set[str]]()

    def running(self) -> dict[str, set[str]]:
        return {self._worker: set(self.handed)}

    def begin_anew(self, worker: str, plan_ids: Any) -> int:
        assert worker == self._worker
        self.begun_anew.append(set(plan_ids))
        return len(plan_ids)


def test_a_job_that_was_handed_over_and_does_not_begin_is_begun_anew_but_not_at_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    settings = WorkerSettings.model_validate({"data_dir": tmp_path, **SOON})
    queue = HandedJobs(settings.executor_name, "at work", "late", "lost")
    at_work, now = {"at work"}, 100.0
    monkeypatch.setattr(time, "monotonic", lambda: now)
    takeover = Takeover(settings, cast(JobQueue, queue), None, lambda: frozenset(at_work), list)

    def begun_anew_at(moment: float) -> set[str]:
        nonlocal now
        now = 100.0 + moment
        queue.begun_anew.clear()
        takeover._look(stuck=False)
        return set().union(*queue.begun_anew)

    assert not begun_anew_at(0.0)
    assert not begun_anew_at(settings.watch_seconds)
    at_work.add("late")
    assert not begun_anew_at(BEGINNING_SECONDS - 0.01)
    assert begun_anew_at(BEGINNING_SECONDS + 0.01) == {"lost"}
    # This worker has taken it again before the next look: it is given its time once more.
    assert not begun_anew_at(BEGINNING_SECONDS + 0.02)
    assert not begun_anew_at(2.0 * BEGINNING_SECONDS)
    assert begun_anew_at(2.0 * BEGINNING_SECONDS + 0.03) == {"lost"}


def test_a_worker_must_stop_before_it_counts_as_frozen(tmp_path: Path) -> None:
    with pytest.raises(ValidationError, match="frozen_seconds"):
        WorkerSettings(data_dir=tmp_path, patience_seconds=40.0)


def test_a_question_that_hangs_costs_one_thread_and_no_more_than_its_time() -> None:
    free, asked = threading.Event(), list[int]()

    def hang() -> str:
        asked.append(1)
        assert free.wait(20)
        return "answer"

    question = PatientQuestion(hang)
    before = threading.active_count()
    for _ in range(20):
        with pytest.raises(TimeoutError):
            question.within(0.01)
    assert threading.active_count() == before + 1
    free.set()
    assert question.within(5.0) == "answer"
    assert len(asked) == 1
    assert question.within(5.0) == "answer"
    assert len(asked) == 2


def test_a_question_that_had_no_room_for_a_thread_can_be_asked_again(monkeypatch: pytest.MonkeyPatch) -> None:
    question = PatientQuestion(lambda: "answer")

    def refuse(_: threading.Thread) -> None:
        raise RuntimeError("can't start new thread")

    with monkeypatch.context() as short:
        short.setattr(threading.Thread, "start", refuse)
        with pytest.raises(RuntimeError, match="new thread"):
            question.within(5.0)
    assert question.within(5.0) == "answer"
