"""One job from its begin to its end, whatever dies in between: solver, database, or the right to do it."""

from __future__ import annotations

import asyncio
import base64
from dataclasses import replace
from functools import partial

import sqlalchemy as sa
import structlog
from sqlalchemy.exc import SQLAlchemyError

from planners.errors import LiftwrightError
from planners.progress import Report
from workers.engine.running_jobs import JobLeft, RunningJobs
from workers.settings import WorkerSettings
from workers.solver.pool import SolverDied, SolverFault, SolverPool
from workers.solver.progress import ProgressScale
from workers.solver.protocol import SolverRequest
from workers.stores.database_loss import once_it_is_there, said_by
from workers.stores.job_queue import JobQueue
from workers.stores.jobs import JobState
from workers.stores.plan_store import PackedDocument, PlanEvent, PlanRecord, PlanStore
from workers.stores.task_parts import TaskParts
from workers.stores.webhook_store import tell_certified
from workers.webhooks.runner import message

CERTIFIED = "certified"
"""What events and messages call it that a plan is certified and can be fetched, while it is still simulated."""
VERDICT = "verdict"
"""What events call it that a proof that there is no plan can be fetched, while changes are tried that would help."""
log = structlog.get_logger(__name__)


class JobFailed(LiftwrightError):
    """A job ended without a document; the message is what the caller is told."""

    def __init__(self, sentence: str, why: str) -> None:
        """`why` is one of few words, for counting."""
        super().__init__(sentence)
        self.why = why


class JobRunner:
    """Runs jobs on the running event loop, at most `worker_slots` at a time."""

    def __init__(
        self, settings: WorkerSettings, queue: JobQueue, store: PlanStore, parts: TaskParts, pool: SolverPool
    ) -> None:
        self._settings, self._queue, self._store, self._parts, self._pool = settings, queue, store, parts, pool
        self._slots = asyncio.Semaphore(settings.worker_slots)
        self.jobs = RunningJobs[PackedDocument]()
        """Those that have a solver process now, or wait for one."""

    async def run(self, plan_id: str) -> str:
        """Run one job to its end and return its outcome.

        Raises:
            JobFailed: It has ended without a document.
            JobLeft: It is not this worker's any more.
        """
        outcome = await once_it_is_there(self._store.outcome, plan_id)
        if outcome is not None:
            # An earlier run stored its document and died before it could say so.
            return outcome
        task = await once_it_is_there(self._store.task, plan_id)
        if task is None:
            raise JobLeft(plan_id)
        parts = await once_it_is_there(self._parts.named_by, [task])
        request = SolverRequest(plan_id, task, parts.meshes, cell_folders=parts.cell_folders)
        async with self._slots:
            return await self._solve_despite_crashes(plan_id, request)

    async def _solve_despite_crashes(self, plan_id: str, request: SolverRequest) -> str:
        while True:
            if await once_it_is_there(self._queue.not_with, self._settings.executor_name, [plan_id]):
                raise JobLeft(plan_id)
            record = await once_it_is_there(self._store.begin_attempt, plan_id)
            if record is None:
                raise JobLeft(plan_id)
            certified = await once_it_is_there(self._store.certified, plan_id)
            if certified is not None:
                # Somebody may have begun to follow that plan: it is simulated, and no other one takes its place.
                request = replace(request, certified=base64.b64encode(certified).decode())
            others = certified is None and await once_it_is_there(self._queue.another_waits)
            request = replace(request, until_certified=others)
            scale = ProgressScale.of(request.task, record.fraction)
            try:
                document = await self._attempt(record, scale, request)
            except JobFailed as failure:
                if not await once_it_is_there(self._store.mark_failed, plan_id, record.attempts, failure.why):
                    raise JobLeft(plan_id) from failure
                log.warning("job failed", job_id=plan_id, why=failure.why, error=str(failure))
                raise
            if document is not None and not document.complete:
                await once_it_is_there(self._keep_certified, record, scale, document)
                await once_it_is_there(self._queue.put_off, self._settings.executor_name, plan_id)
                log.info("job put off for others", job_id=plan_id, outcome=document.outcome)
                # Not `JobLeft`, after which the engine asks for the job's result until there is one.
                raise asyncio.CancelledError
            if document is not None:
                if not await once_it_is_there(self._store.save_document, plan_id, record.attempts, document):
                    raise JobLeft(plan_id)
                log.info("job solved", job_id=plan_id, outcome=document.outcome, bytes=len(document.gzip))
                return document.outcome

    async def _attempt(self, record: PlanRecord, scale: ProgressScale, request: SolverRequest) -> PackedDocument | None:
        """Have a solver process try; None if it died and another one may try."""
        plan_id = record.id

        async def show(report: Report) -> None:
            try:
                await asyncio.to_thread(self._store.add_event, plan_id, _event(record, scale, report))
            except SQLAlchemyError as loss:
                # Whatever the database says, it is no reason to end a job: what the solver reports next tells more.
                log.warning("progress not kept", job_id=plan_id, error=said_by(loss))

        async def show_certified(document: PackedDocument) -> None:
            try:
                await asyncio.to_thread(self._keep_certified, record, scale, document)
            except SQLAlchemyError as loss:
                # It is stored again with what is added to it.
                log.warning("certified plan not kept", job_id=plan_id, error=said_by(loss))

        limit = self._settings.solver_seconds
        try:
            return await self.jobs.run(plan_id, partial(self._pool.solve, request, show, limit, show_certified))
        except TimeoutError:
            raise JobFailed(
                f"the solver was stopped after {limit:g} s, the longest it may take (LIFTWRIGHT_SOLVER_SECONDS)", "time"
            ) from None
        except SolverFault as fault:
            raise JobFailed(str(fault), "fault") from fault
        except SolverDied as death:
            crashes = await once_it_is_there(self._store.count_crash, plan_id)
            log.warning("solver died", job_id=plan_id, crashes=crashes, ending=str(death))
            if crashes >= self._settings.crash_limit:
                raise JobFailed(f"given up after {crashes} attempts: {death}", "crashes") from death
            return None

    def _keep_certified(self, record: PlanRecord, scale: ProgressScale, document: PackedDocument) -> None:
        """Store a document that more will be added to, and tell of it."""
        certified = _event(record, scale, Report("certify", 1, 1))
        solved = document.outcome == "solved"
        told = replace(certified, event=CERTIFIED if solved else VERDICT, outcome=document.outcome)

        def tell(transaction: sa.Connection) -> None:
            # Whoever asked to be told of certified plans goes on with them; where there is none the end is soon enough.
            if solved:
                body = message(record, CERTIFIED, JobState.RUNNING, document.outcome)
                tell_certified(record.id, body, partial(self._enqueue_message, record.id), transaction)

        self._store.save_certified(record.id, document, told, tell)

    def _enqueue_message(self, plan_id: str, transaction: sa.Connection, delivery_id: str) -> None:
        self._queue.enqueue_delivery(transaction, plan_id, delivery_id, number=1, pause=0.0)


def _event(record: PlanRecord, scale: ProgressScale, report: Report) -> PlanEvent:
    """Return what is told of a report of a plan's solver."""
    fraction = round(scale.advance(report), 4)
    return PlanEvent(
        attempt=record.attempts, stage=report.name, done=report.done, total=report.total, fraction=fraction
    )
