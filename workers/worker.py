"""Takes jobs from the queue and has them solved. The engine (DBOS) remembers which job is whose across any death."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Awaitable, Callable
from contextlib import suppress
from typing import Any

import structlog
from dbos import DBOS, DBOSConfig, WorkflowSerializationFormat, error

from planners.contract.uploads import named_uploads
from planners.errors import LiftwrightError
from workers.database import Database
from workers.executor_lock import ExecutorLock
from workers.job_queue import APPLICATION, APPLICATION_VERSION, WORKFLOW, JobQueue
from workers.mesh_store import MeshStore
from workers.plan_store import PlanStore
from workers.progress_scale import ProgressScale
from workers.settings import WorkerSettings
from workers.solver import PackedDocument, SolverCommand, SolverDied, SolverFault, SolverPool
from workers.solver_protocol import HANDOVERS_VARIABLE, REJECTED_VARIABLE, Report, Request

REJECTED_FOLDER = "rejected"
SHUTDOWN_SECONDS = 5

log = structlog.get_logger(__name__)


class JobFailed(LiftwrightError):
    """A job ended without a document; the message is what the caller is told."""


class Worker:
    """Runs jobs on the running event loop. One per process: the engine is a process-wide thing."""

    def __init__(self, settings: WorkerSettings, database: Database, queue: JobQueue, store: PlanStore) -> None:
        self._settings, self._database, self._queue, self._store = settings, database, queue, store
        self._meshes = MeshStore(database)
        rejected = settings.data_dir.resolve() / REJECTED_FOLDER
        folders = {REJECTED_VARIABLE: str(rejected), HANDOVERS_VARIABLE: str(settings.handovers_dir)}
        command = SolverCommand(settings.solver_command, folders)
        self._pool = SolverPool(command, settings.worker_slots)
        self._slots = asyncio.Semaphore(settings.worker_slots)
        self._running: dict[str, asyncio.Task[PackedDocument]] = {}
        self._cancelled: set[str] = set()
        self._stopping = False
        self._watch: asyncio.Task[None] | None = None
        self._lock: ExecutorLock | None = None

    async def start(self) -> None:
        """Get the solver processes ready, then take up the jobs an earlier life left, then new ones.

        Raises:
            WorkerRuns: Another worker of this name is alive.
        """
        name = self._settings.executor_name
        self._lock = ExecutorLock(self._settings.data_dir, name)
        await self._pool.open()
        self._watch = asyncio.create_task(self._watch_for_cancelled_jobs())
        config: DBOSConfig = {
            "name": APPLICATION,
            "system_database_url": self._database.engine_url,
            "application_version": APPLICATION_VERSION,
            "executor_id": name,
            "log_level": "WARNING",
            "enable_otlp": False,
        }
        logging.getLogger("dbos").addFilter(_is_news)
        DBOS(config=config)
        self._register()
        # Before the launch: the engine looks for new queues only once a second.
        await asyncio.to_thread(self._queue.open, self._settings.worker_slots, self._settings.poll_seconds)
        DBOS.launch()

    async def stop(self) -> None:
        """Stop taking jobs; those under way are left to be begun anew after the next start."""
        self._stopping = True
        for task in self._running.values():
            task.cancel()
        if self._watch is not None:
            self._watch.cancel()
            with suppress(asyncio.CancelledError):
                await self._watch
        await self._pool.close()
        await asyncio.to_thread(DBOS.destroy, destroy_registry=True)
        logging.getLogger("dbos").removeFilter(_is_news)
        if self._lock is not None:
            self._lock.release()

    def _register(self) -> None:
        """Tell the engine what a job is. The step's result is stored, so a finished one is not run again."""

        @DBOS.step(name="solve")
        async def solve(plan_id: str) -> str:
            return await self._solve(plan_id)

        @DBOS.workflow(
            name=WORKFLOW,
            serialization_type=WorkflowSerializationFormat.PORTABLE,
            max_recovery_attempts=self._settings.interruption_limit,
        )
        async def plan(plan_id: str) -> str:
            return await solve(plan_id)

        self._workflow: Callable[[str], Awaitable[str]] = plan

    async def _solve(self, plan_id: str) -> str:
        """Run one job to its end and return its outcome."""
        task = await asyncio.to_thread(self._store.task, plan_id)
        if task is None:
            raise JobFailed("the plan was deleted before it was solved")
        meshes = await asyncio.to_thread(self._meshes.documents, named_uploads(task))
        request: Request = {"id": plan_id, "task": task, "meshes": meshes}
        try:
            async with self._slots:
                document = await self._solve_despite_crashes(plan_id, request)
        except JobFailed:
            await asyncio.to_thread(self._store.mark_finished, plan_id)
            raise
        await asyncio.to_thread(self._store.save_document, plan_id, document.outcome, document.sha256, document.gzip)
        log.info("job solved", job_id=plan_id, outcome=document.outcome, bytes=len(document.gzip))
        return document.outcome

    async def _solve_despite_crashes(self, plan_id: str, request: Request) -> PackedDocument:
        while True:
            record = await asyncio.to_thread(self._store.begin_attempt, plan_id)
            if record is None:
                raise JobFailed("the plan was deleted before it was solved")
            scale = ProgressScale.of(request["task"], record.fraction)
            try:
                return await self._attempt(plan_id, request, record.attempts, scale)
            except SolverFault as fault:
                raise JobFailed(str(fault)) from fault
            except SolverDied as death:
                crashes = await asyncio.to_thread(self._store.count_crash, plan_id)
                log.warning("solver died", job_id=plan_id, crashes=crashes, ending=str(death))
                if crashes >= self._settings.crash_limit:
                    raise JobFailed(f"given up after {crashes} attempts: {death}") from death

    async def _attempt(self, plan_id: str, request: Request, attempt: int, scale: ProgressScale) -> PackedDocument:
        async def show(report: Report) -> None:
            fraction = scale.advance(report["stage"], report["done"], report["total"])
            event: dict[str, Any] = {"attempt": attempt, **report, "fraction": round(fraction, 4)}
            await asyncio.to_thread(self._store.add_event, plan_id, event)

        if plan_id in await asyncio.to_thread(self._queue.cancelled, [plan_id]):
            raise error.DBOSWorkflowCancelledError(f"plan {plan_id} was cancelled")
        task = asyncio.create_task(self._pool.solve(request, show))
        self._running[plan_id] = task
        try:
            return await task
        except asyncio.CancelledError:
            if self._stopping:
                # Not an end of the job: it stays begun, and is begun anew when a worker of this name starts.
                await asyncio.Event().wait()
            if plan_id in self._cancelled:
                raise error.DBOSWorkflowCancelledError(f"plan {plan_id} was cancelled") from None
            task.cancel()
            raise
        finally:
            self._running.pop(plan_id, None)
            self._cancelled.discard(plan_id)

    async def _watch_for_cancelled_jobs(self) -> None:
        """Anybody may cancel a job through the database; the engine itself would look only once a second."""
        while True:
            await asyncio.sleep(self._settings.cancel_poll_seconds)
            if not self._running:
                continue
            for plan_id in await asyncio.to_thread(self._queue.cancelled, list(self._running)):
                if plan_id in self._running:
                    self._cancelled.add(plan_id)
                    self._running[plan_id].cancel()


def _is_news(record: logging.LogRecord) -> bool:
    """The engine logs jobs that were cancelled, deleted or failed as they should as errors with tracebacks."""
    raised = record.exc_info[1] if record.exc_info else None
    cancelled = error.DBOSWorkflowCancelledError | error.DBOSAwaitedWorkflowCancelledError
    expected = cancelled | error.DBOSNonExistentWorkflowError | JobFailed
    return not isinstance(raised, expected)
