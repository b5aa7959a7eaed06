"""Takes jobs from the queue and has them solved. The engine (DBOS) remembers which job is whose across any death."""

from __future__ import annotations

import asyncio
import logging
from collections import Counter
from collections.abc import Awaitable, Callable, Collection, Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import partial
from typing import Any

import sqlalchemy as sa
import structlog
from dbos import DBOS, DBOSConfig, WorkflowSerializationFormat, error
from dbos._dbos import _get_dbos_instance

from workers.engine.deadline import PatientQuestion
from workers.engine.executor_lock import AdvisoryLock
from workers.engine.housekeeping import (
    DELETION_PAUSE_SECONDS,
    cancel_overdue,
    clear_cells,
    count_failures,
    delete_old,
    delete_old_audit,
)
from workers.engine.job_runner import JobFailed, JobRunner
from workers.engine.sign_of_life import SignOfLife
from workers.engine.study_runner import StudyRunner
from workers.engine.supervisor import Supervisor
from workers.engine.takeover import Takeover
from workers.settings import WorkerSettings
from workers.solver.examiner_pool import ExaminerPool
from workers.solver.pool import SolverCommand, SolverPool
from workers.stores.cell_store import CellStore
from workers.stores.database import Database
from workers.stores.database_loss import DATABASE_GONE, said_by
from workers.stores.job_queue import (
    APPLICATION,
    APPLICATION_VERSION,
    DELIVERY_QUEUE,
    DELIVERY_WORKFLOW,
    QUEUE,
    STUDY_QUEUE,
    STUDY_WORKFLOW,
    WORKFLOW,
    JobQueue,
    QueueLook,
    delivery_workflow_id,
    part_workflow_id,
    queue_looks,
)
from workers.stores.mesh_store import MeshStore
from workers.stores.plan_store import PlanStore
from workers.stores.scene_store import SceneStore
from workers.stores.study_store import StudyStore
from workers.stores.task_parts import TaskParts
from workers.stores.webhook_store import WebhookStore
from workers.webhooks.runner import WebhookRunner

STUDIES_NICER = 5
"""So much further than solvers of plans do those of studies stand back."""
GOODBYE_SECONDS = 10.0
"""How long the engine may take to end [s]."""
LAUNCHES = 10
"""So often the engine is launched at most, if the database is lost meanwhile [1]."""
JULIAN_DAY_OF_1970 = 2440587.5
MS_PER_DAY = 86_400_000

log = structlog.get_logger(__name__)


class Worker:
    """Runs jobs on the running event loop. One per process: the engine is a process-wide thing."""

    def __init__(
        self,
        settings: WorkerSettings,
        database: Database,
        queue: JobQueue,
        store: PlanStore,
        supervisor: Supervisor,
        pool: SolverPool | None = None,
    ) -> None:
        """Take what jobs are worked with.

        Args:
            settings: of the worker.
            database: that jobs and plans are in.
            queue: of jobs, in the database.
            store: of plans, in the database.
            supervisor: has everything looked after that recurs.
            pool: of solvers, which may have been opened; this worker closes it. None: one of its own.
        """
        self._settings, self._database, self._queue, self._store = settings, database, queue, store
        self._supervisor = supervisor
        self._pool = SolverPool.of(settings) if pool is None else pool
        self._cells = CellStore(database, settings.cells_dir)
        parts = TaskParts(MeshStore(database), self._cells)
        self._runner = JobRunner(settings, queue, store, parts, self._pool)
        self._studies = StudyStore(database, store, queue)
        self._examiners = ExaminerPool(SolverCommand.of(settings, settings.study_command, STUDIES_NICER))
        self._study_runner = StudyRunner(settings, queue, self._studies, parts, self._examiners)
        self._webhooks = WebhookRunner(settings, queue, store, WebhookStore(database))
        self._at_work = Counter[str]()
        """The jobs that the engine has given to this process and has no result of yet; one may be begun while its last
        run still ends."""
        self._telling: asyncio.Task[None] | None = None
        lock = None if settings.embedded else AdvisoryLock(database, settings.executor_name)
        self._sign = SignOfLife(settings)
        self._takeover = Takeover(settings, queue, lock, lambda: frozenset(self._at_work), lambda: supervisor.stuck)

    async def start(self) -> None:
        """Start the solver processes, then take up the jobs an earlier life left, then new ones.

        Whatever comes before a solver is ready waits for it: nobody who wants to post waits, too.

        Raises:
            WorkerRuns: Another worker of this name is alive.
        """
        await self._takeover.start()
        self._pool.open()
        self._telling = asyncio.create_task(self._tell_when_loaded())
        looks = queue_looks(self._settings.worker_slots, self._settings.study_slots, self._settings.poll_seconds)
        self._watch(looks)
        # Before the launch: the engine looks for new queues only once a second.
        await asyncio.to_thread(self._database.at_start, partial(self._queue.open, looks))
        logging.getLogger("dbos").addFilter(_is_news)
        for left in reversed(range(LAUNCHES)):
            try:
                self._launch()
                break
            except DATABASE_GONE as error:
                if not left:
                    raise
                log.warning("waiting for the database", error=said_by(error))
            # Not on the loop, which has other things to see to.
            await asyncio.to_thread(self._database.at_start, self._database.require_writable)
        take_turns(self._queue)
        look_as_told(looks)

    def _launch(self) -> None:
        """Have the engine of this process begin jobs; of one that met no database nothing is left."""
        config: DBOSConfig = {
            "name": APPLICATION,
            "system_database_url": self._database.engine_url,
            "system_database_engine": self._database.shared_engine,
            "application_version": APPLICATION_VERSION,
            "executor_id": self._settings.executor_name,
            "log_level": "WARNING",
            "enable_otlp": False,
        }
        DBOS(config=config)
        self._register()
        try:
            DBOS.launch()
        except DATABASE_GONE:
            DBOS.destroy(destroy_registry=True)
            raise

    async def stop(self) -> None:
        """Stop taking jobs; those under way are left to be begun anew after the next start, or by another worker.

        The supervisor must have stopped before.
        """
        self._runner.jobs.stop()
        self._study_runner.jobs.stop()
        if self._telling is not None:
            self._telling.cancel()
        try:
            await self._pool.close()
            await self._examiners.close()
        finally:
            # Whatever is wrong with solvers: the name must be free for the next worker.
            await self._leave_engine()
            self._takeover.stop()
            self._sign.withdraw()

    async def _tell_when_loaded(self) -> None:
        loaded, slots = await self._pool.loaded(), self._settings.worker_slots
        if loaded == slots:
            log.info("solvers are loaded", slots=slots)
        else:
            log.warning("not all solvers could be loaded", loaded=loaded, slots=slots)

    def _watch(self, looks: Mapping[str, QueueLook]) -> None:
        """Have everything looked after that no request and no job would see to."""
        settings, repeat, store, queue = self._settings, self._supervisor.repeat, self._store, self._queue
        repeat("jobs", self._leave_lost_jobs, settings.cancel_poll_seconds)
        repeat("proof of life", self._leave_all_if_alone, settings.cancel_poll_seconds)
        repeat("fleet", self._takeover.look, settings.watch_seconds)
        if not settings.embedded:
            repeat("sign of life", self._show_life, settings.watch_seconds, at_once=True)
        repeat("webhooks", partial(asyncio.to_thread, self._webhooks.look), looks[DELIVERY_QUEUE].seconds)
        repeat("expiry", partial(asyncio.to_thread, partial(cancel_overdue, store, queue)), settings.watch_seconds)
        repeat("failures", partial(asyncio.to_thread, partial(count_failures, store)), settings.watch_seconds)
        repeat("cells", partial(asyncio.to_thread, partial(clear_cells, self._cells)), DELETION_PAUSE_SECONDS)
        if settings.retention_days is not None:
            stores = store, SceneStore(self._database), self._studies
            delete = partial(delete_old, *stores, queue, settings.retention_days)
            repeat("retention", partial(asyncio.to_thread, delete), DELETION_PAUSE_SECONDS, at_once=True)
        if settings.audit_days is not None:
            delete_audit = partial(delete_old_audit, self._database, settings.audit_days)
            repeat("audit log", partial(asyncio.to_thread, delete_audit), DELETION_PAUSE_SECONDS, at_once=True)

    async def _leave_engine(self) -> None:
        with suppress(TimeoutError):
            # Without a database the engine's threads wait for it, and cannot be told not to.
            async with asyncio.timeout(GOODBYE_SECONDS):
                # Nor may they hold up the end of this process, as a thread of the loop's own would.
                left = PatientQuestion(partial(DBOS.destroy, destroy_registry=True)).ask()
                await asyncio.shield(asyncio.wrap_future(left))
        logging.getLogger("dbos").removeFilter(_is_news)

    def _register(self) -> None:
        """Tell the engine what a job is. The step's result is stored, so a finished one is not run again."""

        @DBOS.step(name="solve")
        async def solve(plan_id: str) -> str:
            return await self._runner.run(plan_id)

        @DBOS.workflow(
            name=WORKFLOW,
            serialization_type=WorkflowSerializationFormat.PORTABLE,
            max_recovery_attempts=self._settings.interruption_limit,
        )
        async def plan(plan_id: str) -> str:
            with self._working_on(plan_id):
                return await solve(plan_id)

        @DBOS.step(name="examine points")
        async def examine_points(study_id: str, part: int) -> str:
            return await self._study_runner.run(study_id, part)

        @DBOS.workflow(
            name=STUDY_WORKFLOW,
            serialization_type=WorkflowSerializationFormat.PORTABLE,
            max_recovery_attempts=self._settings.interruption_limit,
        )
        async def examine(study_id: str, part: int) -> str:
            with self._working_on(part_workflow_id(study_id, part)):
                return await examine_points(study_id, part)

        @DBOS.step(name="post")
        async def post(delivery_id: str, number: int) -> str:
            return await self._webhooks.attempt(delivery_id, number)

        @DBOS.workflow(name=DELIVERY_WORKFLOW, serialization_type=WorkflowSerializationFormat.PORTABLE)
        async def deliver(plan_id: str, delivery_id: str, number: int) -> str:
            with self._working_on(delivery_workflow_id(plan_id, delivery_id, number)):
                return await post(delivery_id, number)

        self._workflows: tuple[Callable[..., Awaitable[str]], ...] = (plan, examine, deliver)

    @contextmanager
    def _working_on(self, workflow_id: str) -> Iterator[None]:
        self._at_work[workflow_id] += 1
        try:
            yield
        finally:
            self._at_work[workflow_id] -= 1
            self._at_work += Counter()

    async def _leave_lost_jobs(self) -> None:
        """Leave the jobs that were cancelled, which anybody may do through the database, or that others have now."""
        solving = [*self._runner.jobs.ids, *self._study_runner.jobs.ids]
        if not solving:
            return
        with suppress(*DATABASE_GONE):
            self._leave(await asyncio.to_thread(self._queue.not_with, self._settings.executor_name, solving))

    async def _leave_all_if_alone(self) -> None:
        """Leave all jobs once others may have them; beside what looks for lost ones, which may hang on the database."""
        if self._takeover.alone:
            self._leave([*self._runner.jobs.ids, *self._study_runner.jobs.ids])

    async def _show_life(self) -> None:
        """Say that this process gets on: its loop turns, for this is called by it, and nothing in it is stuck."""
        if not self._supervisor.stuck:
            self._sign.give()

    def _leave(self, job_ids: Collection[str]) -> None:
        for job_id in job_ids:
            self._runner.jobs.leave(job_id)
            self._study_runner.jobs.leave(job_id)


def take_turns(queue: JobQueue) -> None:
    """Have the engine of this process begin jobs as `queue` says whose turn it is, one at each look.

    By itself it knows one order for all: whoever posts with the highest priority again and again would be the only one.
    Workers that look at the same time may both want the same job: the engine has the second skip it, and look again.
    """
    engine = _engine()

    def gate(queue_name: str, _partition: str | None) -> list[sa.ColumnElement[bool]]:
        job = engine.tables.workflow_status.c.workflow_uuid
        return [queue.is_next(job, queue_name)] if queue_name in (QUEUE, STUDY_QUEUE) else []

    assert hasattr(engine, "_claim_gate"), "this version of the engine cannot be told whose turn it is"
    # What its own kinds of databases override, to say what else must hold of the jobs that it takes.
    engine._claim_gate = gate
    if engine.engine.dialect.name == "sqlite":
        assert hasattr(engine, "_now_ms_sql"), "this version of the engine cannot be told the time"
        # With Python 3.11 it knows whole seconds there: of jobs that were begun in one, nobody knew which was the last.
        engine._now_ms_sql = _sqlite_now_ms


def look_as_told(looks: Mapping[str, QueueLook]) -> None:
    """Have the engine of this process look at each queue as its own worker's settings say.

    By itself it reads from the database, before each look, what the worker that was started last has stored for all: a
    machine of two cores would take as many jobs as the largest, and a third of all statements would be for that.
    """
    engine = _engine()
    assert hasattr(engine, "get_queue"), "this version of the engine cannot be told how to look at queues"
    stored, known = engine.get_queue, dict[str, Any]()

    def get_queue(name: str, **options: Any) -> Any:
        if name not in known:
            queue = stored(name, **options)
            if queue is None or name not in looks:
                return queue
            queue._worker_concurrency, queue._polling_interval_sec = looks[name].most, looks[name].seconds
            known[name] = queue
        return known[name]

    engine.get_queue = get_queue


def _sqlite_now_ms() -> sa.ColumnElement[int]:
    """Return the time by SQLite's clock [ms since 1970]."""
    days = sa.func.julianday("now") - JULIAN_DAY_OF_1970
    return sa.cast(sa.func.round(days * MS_PER_DAY), sa.BigInteger)


def _engine() -> Any:
    """Return the engine's own database, which has no public name."""
    return _get_dbos_instance()._sys_db


def _is_news(record: logging.LogRecord) -> bool:
    """The engine logs jobs that were cancelled, deleted or failed as they should as errors with tracebacks."""
    raised = record.exc_info[1] if record.exc_info else None
    cancelled = error.DBOSWorkflowCancelledError | error.DBOSAwaitedWorkflowCancelledError
    expected = cancelled | error.DBOSNonExistentWorkflowError | JobFailed
    return not isinstance(raised, expected)
