"""Plans with their jobs: what the routes ask for, put together from the store and the queue."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from typing import Any

from starlette.concurrency import run_in_threadpool

from app.access.audit_log import audit_row
from app.access.caller import ANYBODY, Caller, Scope
from app.errors import (
    ANSWERED,
    AlreadyFinished,
    DocumentNotReady,
    KeyUsedForAnotherTask,
    NotFinished,
    PlanNotFound,
    QueueFull,
    ServiceError,
    ShareFull,
    TooManyDelayed,
)
from app.resources.queries import PlanQuery, page_of
from app.resources.schemas import PlanResource, plan_address, plan_resource
from planners.contract.task_spec import TaskSpec, read_task, to_post_again, write_task
from workers.stores.job_queue import JobQueue, Pace
from workers.stores.jobs import Job, JobOrder, JobState
from workers.stores.plan_store import (
    NO_ORDER,
    NoRoom,
    PlanRecord,
    PlanStore,
    Room,
    StoredDocument,
    Submission,
    fingerprint,
)
from workers.stores.plan_writer import PlanWriter
from workers.stores.tables import AuditRow, Position, now_us

NEW_JOB = Job(JobState.QUEUED, None, None)


class PlanCollection:
    """What one caller sees of all plans: what belongs to somebody else does not exist.

    All methods but `submit` block on the database: call them from a thread.
    """

    def __init__(
        self, store: PlanStore, queue: JobQueue, writer: PlanWriter, room: Room, caller: Caller = ANYBODY
    ) -> None:
        self.store, self.queue, self._caller = store, queue, caller
        self._writer, self._room = writer, room

    def seen_by(self, caller: Caller) -> PlanCollection:
        """Return what another caller sees."""
        return PlanCollection(self.store, self.queue, self._writer, self._room, caller)

    async def submit(
        self,
        read: Callable[[], Any],
        accepted: Callable[[Any], TaskSpec],
        idempotency_key: str | None,
        order: JobOrder = NO_ORDER,
        address: str | None = None,
    ) -> tuple[PlanResource, bool]:
        """Accept a task, or find the plan that the same key made; then its first order stands.

        It blocks nobody. The entry of the audit log is kept in the transaction that stores the plan.

        Args:
            read: returns the task as JSON data, as it came. Called in a thread, as is the next one.
            accepted: returns that task with defaults filled in, or raises what is wrong with it; that does not count
                of one that came before, which may name what is gone since.
            idempotency_key: of the caller, if it has one.
            order: what it says about the job.
            address: from which the request came, for the audit log.

        Returns:
            The plan, and whether this has made it.

        Raises:
            QueueFull: There are too many unfinished jobs.
            ShareFull: There are too many of the caller's.
            TooManyDelayed: Too many of the caller's wait for their start.
            KeyUsedForAnotherTask: The key was used for another task.
        """

        def prepare() -> tuple[Any, Submission | PlanRecord]:
            sent, owner = read(), self._caller.owner
            try:
                task = write_task(accepted(sent))
            except ANSWERED:
                known = self.store.by_key(idempotency_key, owner)
                if known is None:
                    raise
                return sent, known

            def audit(plan_id: str) -> AuditRow:
                return audit_row(self._caller, address, "POST", plan_address(plan_id), 202)

            return sent, Submission.of(task, owner, order, idempotency_key, fingerprint(sent), audit)

        sent, prepared = await run_in_threadpool(prepare)
        if isinstance(prepared, Submission):
            answer = await asyncio.wrap_future(self._writer.submit(prepared))
            if isinstance(answer, NoRoom):
                raise _refusal(answer, self._room)
            if answer.is_new:
                return plan_resource(answer.record, NEW_JOB, answer.place), True
            prepared = answer.record
        return await run_in_threadpool(self._again, prepared, sent, accepted), False

    def admit(self, submission: Submission) -> PlanResource:
        """Accept a task that was checked before, or find the plan that its key made, as `submit` does.

        Raises:
            QueueFull: There are too many unfinished jobs.
            ShareFull: There are too many of its owner's.
        """
        answer = self._writer.submit(submission).result()
        if isinstance(answer, NoRoom):
            raise _refusal(answer, self._room)
        return self.plan(answer.record.id)

    def _again(self, record: PlanRecord, sent: Any, accepted: Callable[[Any], TaskSpec]) -> PlanResource:
        """Return the plan that a key made before.

        Raises:
            KeyUsedForAnotherTask: Of another task than the one that was sent.
        """
        # The same may be sent in other words, and of old plans only what they were taken for is known.
        if record.sent_fingerprint != fingerprint(sent) and not self._asks_for(record, accepted(sent)):
            raise KeyUsedForAnotherTask
        return self._with_job(record)

    def _asks_for(self, record: PlanRecord, task: TaskSpec) -> bool:
        """Tell whether a plan's task is the same as another one, with the defaults of today filled in both."""
        stored = self.store.task(record.id)
        return stored is not None and to_post_again(read_task(stored)) == to_post_again(task)

    def plan(self, plan_id: str) -> PlanResource:
        """Return one plan.

        Raises:
            PlanNotFound: There is none of that id.
        """
        record = self.store.get(plan_id)
        if record is None or not self._caller.may_see(record.owner):
            raise PlanNotFound(plan_id)
        return self._with_job(record)

    def page(self, query: PlanQuery) -> tuple[list[PlanResource], Position | None]:
        """Return the plans that are asked for, newest first, and where the next page begins, if there is one."""
        size = query.page_size
        owner = None if self._caller.scope is Scope.ADMIN else self._caller.owner
        shown, position = page_of(self.store.newest(size + 1, query.position, query.filter(owner)), size)
        jobs = self.queue.jobs([record.id for record in shown])
        places, pace = self._places(jobs)
        plans = [self._resource(record, jobs[record.id], places, pace) for record in shown if record.id in jobs]
        # A job may have gone on since it was found.
        return [plan for plan in plans if query.state in (None, plan.state)], position

    def task(self, plan_id: str) -> dict[str, Any]:
        """Return the task of a plan as it was accepted, which may be posted again.

        Raises:
            PlanNotFound: There is no plan of that id.
        """
        task = self.store.task(self.plan(plan_id).id)
        if task is None:
            raise PlanNotFound(plan_id)
        # Of old plans it is not told that nothing of a scene is missing.
        return dict(task) if task.get("scene_id") is None else {**task, "scene_filled": True}

    def document(self, plan_id: str) -> StoredDocument:
        """Return the document of a plan of which it is known whether there is one.

        Raises:
            PlanNotFound: There is no plan of that id.
            DocumentNotReady: That is not known yet, or will never be.
        """
        plan = self.plan(plan_id)
        document = None if plan.verdict is None else self.store.document(plan_id)
        if document is None:
            raise DocumentNotReady(plan.state, done=plan.done)
        return document

    def cancel(self, plan_id: str) -> PlanResource:
        """Cancel a plan's job.

        Raises:
            PlanNotFound: There is no plan of that id.
            AlreadyFinished: Its job has ended, be it just now.
        """
        plan = self.plan(plan_id)
        if not plan.done:
            self.queue.cancel(plan_id)
            plan = self.plan(plan_id)
            if plan.state == JobState.CANCELLED.value:
                self.store.mark_finished(plan_id)
                return self.plan(plan_id)
        raise AlreadyFinished(plan.state)

    def delete(self, plan_id: str) -> None:
        """Remove a plan and all that belongs to it.

        Raises:
            PlanNotFound: There is no plan of that id.
            NotFinished: Its job has not ended.
        """
        plan = self.plan(plan_id)
        if not plan.done:
            raise NotFinished(plan.state)
        # The job first: a plan without a job is found again by whoever deletes what is old.
        self.queue.forget(plan_id)
        self.store.delete(plan_id)

    def _with_job(self, record: PlanRecord) -> PlanResource:
        jobs = self.queue.jobs([record.id])
        if record.id not in jobs:
            raise PlanNotFound(record.id)
        return self._resource(record, jobs[record.id], *self._places(jobs))

    def _places(self, jobs: Mapping[str, Job]) -> tuple[dict[str, int], Pace | None]:
        """Return the places in the queue of those that wait, and how fast it goes on."""
        waiting = [plan_id for plan_id, job in jobs.items() if job.state is JobState.QUEUED]
        if not waiting:
            return {}, None
        return self.queue.places(waiting, self._room.jobs), self.queue.pace(self._room.jobs)

    def _resource(self, record: PlanRecord, job: Job, places: Mapping[str, int], pace: Pace | None) -> PlanResource:
        # What was stored between the two reads belongs to the state that was read last.
        fresh = self.store.get(record.id) if job.state.done and record.finished_us is None else record
        place = places.get(record.id) if job.state is JobState.QUEUED else None
        expected_us = None if place is None or pace is None else now_us() + round(1e6 * pace.wait(place))
        return plan_resource(fresh or record, job, place, expected_us)


def _refusal(why: NoRoom, room: Room) -> ServiceError:
    """Return what a caller is told for whose task there is no room."""
    match why:
        case NoRoom.QUEUE_FULL:
            return QueueFull(room.jobs)
        case NoRoom.SHARE_FULL:
            return ShareFull(room.jobs_of_owner)
        case NoRoom.TOO_MANY_DELAYED:
            return TooManyDelayed(room.delayed)
