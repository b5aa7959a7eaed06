"""The engine as seen from outside: enqueue, look, cancel, forget. Works without running any job itself."""

from __future__ import annotations

import json
import time
import uuid
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import sqlalchemy as sa
from dbos import DBOSClient, EnqueueOptions, WorkflowSerializationFormat

from workers.stores.database import Database
from workers.stores.jobs import (
    DELAYED,
    ENQUEUED,
    HIGHEST_PRIORITY,
    PUT_OFF,
    QUEUED,
    RUNNING,
    STATE_OF_STATUS,
    Job,
    JobState,
    input_table,
    state_of,
    together,
    workflow_table,
)
from workers.stores.totals import TAKEOVER, add_to_total

QUEUE = "plans"
WORKFLOW = "plan"
STUDY_QUEUE = "studies"
STUDY_WORKFLOW = "examine"
DELIVERY_QUEUE = "webhooks"
DELIVERY_WORKFLOW = "deliver"
DELIVERIES_AT_ONCE = 16
DELIVERY_POLL_SECONDS = 0.5
STUDY_POLL_SECONDS = 0.5
APPLICATION = "liftwright"
APPLICATION_VERSION = "1"
"""Pinned: by default it is a hash of the code, and jobs of another version are neither begun nor recovered."""
PORTABLE_JSON = "portable_json"
"""What the engine writes for `WorkflowSerializationFormat.PORTABLE`."""
STUDY_ID_LENGTH = 32
TIMED = (JobState.SUCCEEDED, JobState.FAILED)
"""How jobs end that were not stopped."""
TURNS_REMEMBERED = 200
"""Of so many jobs that were begun last it is known whose they were [1]; more owners than that take less even turns."""
PUT_OFF_SECONDS = 60.0
"""A job that was put off for so long takes its turn like any other [s]."""
JOBS_TIMED = 50
"""From so many jobs that were begun last it is told how long one takes [1]."""
INTERRUPTED_TOO_OFTEN = "the worker died each time it ran this job, so it is not begun again"


@dataclass(frozen=True)
class Depth:
    """How many jobs have not ended."""

    queued: int
    """That may be begun."""
    delayed: int
    """That wait for their start."""
    running: int

    @property
    def due(self) -> int:
        """How many of them want a worker now."""
        return self.queued + self.running


@dataclass(frozen=True)
class Pace:
    """How fast jobs are done of late."""

    running: int
    """Jobs that run at a time."""
    seconds: float
    """Mean duration of those that ended [s]."""

    def wait(self, place: int) -> float:
        """Return how long a job at a place in the queue waits most likely [s]: those that run are halfway through."""
        return self.seconds * (place - 0.5) / self.running


@dataclass(frozen=True)
class QueueLook:
    """How a worker takes what waits in a queue."""

    most: int
    """So much at the same time [1]."""
    seconds: float
    """Between two looks [s]."""


def queue_looks(worker_slots: int, study_slots: int, poll_seconds: float) -> dict[str, QueueLook]:
    """Return how a worker looks at each queue that takes so many jobs at a time, and looks for new ones so often [s].

    Beside them it takes parts of studies: nobody's plan waits until a study is done, and a study may wait for a moment.
    """
    return {
        QUEUE: QueueLook(worker_slots, poll_seconds),
        STUDY_QUEUE: QueueLook(study_slots, max(poll_seconds, STUDY_POLL_SECONDS)),
        DELIVERY_QUEUE: QueueLook(DELIVERIES_AT_ONCE, DELIVERY_POLL_SECONDS),
    }


@dataclass(frozen=True)
class NewJob:
    """A job that is to be enqueued. Times are microseconds since 1970, UTC."""

    plan_id: str
    created_us: int
    owner: str | None
    """With whose jobs it takes turns; None: those of nobody, who is an owner like others."""
    priority: int = 0
    """0 … 9; of its owner's jobs the highest goes first, and of equal ones the oldest."""
    start_us: int | None = None
    """Before which it may not be begun; None: at once."""


class JobQueue:
    """Jobs are named by their plan's id. A database that is gone is an error at once, never a wait."""

    def __init__(self, database: Database) -> None:
        self._client = DBOSClient(
            system_database_url=database.engine_url,
            system_database_engine=database.shared_engine,
            application_name=APPLICATION,
            retry_connection_errors=False,
            # It asks nothing yet: a start has just found the database, and waits for it if it is lost again.
            lazy=True,
        )
        self._database = database
        self._jobs = workflow_table(database.engine.dialect.name)
        self._inputs = input_table(database.engine.dialect.name)

    def close(self) -> None:
        """Give all connections back."""
        self._client.destroy()

    def open(self, looks: Mapping[str, QueueLook]) -> None:
        """Have the engine know each queue, by its name; a worker looks at it as it says."""
        for name, look in looks.items():
            self._client.register_queue(
                name, worker_concurrency=look.most, polling_interval_sec=look.seconds, on_conflict="always_update"
            )

    def enqueue(self, transaction: sa.Connection, jobs: Sequence[NewJob]) -> None:
        """Enqueue jobs; they exist when `transaction` commits.

        The rows are written here, as the engine would write them: it takes one job at a time, each with two statements
        that it compiles anew.
        """
        rows = [
            {
                "workflow_uuid": job.plan_id,
                "status": ENQUEUED if job.start_us is None else DELAYED,
                "name": WORKFLOW,
                "queue_name": QUEUE,
                # The engine has an index of what waits and runs by it, and makes no other use of it in this queue.
                "queue_partition_key": job.owner,
                "application_name": APPLICATION,
                "application_version": APPLICATION_VERSION,
                "serialization": PORTABLE_JSON,
                # The engine's count goes the other way, from 1.
                "priority": 1 + HIGHEST_PRIORITY - job.priority,
                "recovery_attempts": 0,
                "creator_xid": str(uuid.uuid4()),
                "delay_until_epoch_ms": None if job.start_us is None else job.start_us // 1000,
                "created_at": job.created_us // 1000,
                "updated_at": job.created_us // 1000,
            }
            for job in jobs
        ]
        inputs = [
            {
                "workflow_uuid": job.plan_id,
                "inputs": json.dumps({"namedArgs": {}, "positionalArgs": [job.plan_id]}, separators=(",", ":")),
                "retention_timestamp": job.created_us // 1000,
            }
            for job in jobs
        ]
        transaction.execute(sa.insert(self._jobs), rows)
        transaction.execute(sa.insert(self._inputs), inputs)

    def enqueue_part(self, transaction: sa.Connection, study_id: str, part: int) -> None:
        """Enqueue one part of a study; it exists when `transaction` commits."""
        options: EnqueueOptions = {
            "workflow_name": STUDY_WORKFLOW,
            "queue_name": STUDY_QUEUE,
            "workflow_id": part_workflow_id(study_id, part),
            "app_version": APPLICATION_VERSION,
            "serialization_type": WorkflowSerializationFormat.PORTABLE,
        }
        self._client.enqueue_in_transaction(transaction, options, study_id, part)

    def enqueue_delivery(
        self, transaction: sa.Connection, plan_id: str, delivery_id: str, number: int, pause: float
    ) -> None:
        """Enqueue one try to deliver a message about a plan, to be made after a pause [s]."""
        options: EnqueueOptions = {
            "workflow_name": DELIVERY_WORKFLOW,
            "queue_name": DELIVERY_QUEUE,
            "workflow_id": delivery_workflow_id(plan_id, delivery_id, number),
            "app_version": APPLICATION_VERSION,
            "serialization_type": WorkflowSerializationFormat.PORTABLE,
        }
        if pause > 0.0:
            options["delay_seconds"] = pause
        self._client.enqueue_in_transaction(transaction, options, plan_id, delivery_id, number)

    def jobs(self, plan_ids: Sequence[str]) -> dict[str, Job]:
        """Return the jobs of `plan_ids`; one that does not exist is left out."""
        if not plan_ids:
            return {}
        columns = (self._jobs.c.workflow_uuid, self._jobs.c.status, self._jobs.c.priority, self._jobs.c.updated_at)
        rows = self._database.rows(sa.select(*columns).where(self._jobs.c.workflow_uuid.in_(plan_ids)))
        states = {row.workflow_uuid: state_of(row.status, row.priority or 0) for row in rows}
        errors = self._errors([plan_id for plan_id, state in states.items() if state is JobState.FAILED])
        return {
            row.workflow_uuid: _job(states[row.workflow_uuid], row.updated_at, errors.get(row.workflow_uuid))
            for row in rows
        }

    def study_jobs(self, parts: Mapping[str, int]) -> dict[str, Job]:
        """Return how studies stand, all their parts together; one of which nothing is known is left out.

        Args:
            parts: how many each study has, by its id.
        """
        ids = {study: [part_workflow_id(study, part) for part in range(count)] for study, count in parts.items()}
        jobs = self.jobs([each for known in ids.values() for each in known])
        found = {study: [jobs[each] for each in known if each in jobs] for study, known in ids.items()}
        return {study: together(known) for study, known in found.items() if known}

    def unfinished_studies(self, most: int) -> int:
        """Return how many studies have parts that have not ended, counted up to `most`."""
        study = sa.func.substr(self._jobs.c.workflow_uuid, 1, STUDY_ID_LENGTH)
        unfinished = sa.select(study).where(
            self._jobs.c.queue_name == STUDY_QUEUE, self._jobs.c.status.in_((*QUEUED, RUNNING))
        )
        found = unfinished.distinct().limit(most).subquery()
        return self._database.scalar(sa.select(sa.func.count()).select_from(found)) or 0

    def not_with(self, worker: str, plan_ids: Collection[str]) -> set[str]:
        """Return those of `plan_ids` that `worker` is not running: cancelled, deleted, or with somebody else."""
        query = sa.select(self._jobs.c.workflow_uuid).where(
            self._jobs.c.workflow_uuid.in_(sorted(plan_ids)),
            self._jobs.c.status == RUNNING,
            self._jobs.c.executor_id == worker,
        )
        return set(plan_ids) - set(self._database.column(query))

    def cancel(self, plan_id: str) -> None:
        """Cancel a job; one that has ended stays as it is."""
        self._client.cancel_workflow(plan_id)

    def cancel_study(self, study_id: str, parts: int) -> None:
        """Cancel all parts of a study; those that have ended stay as they are."""
        for part in range(parts):
            self._client.cancel_workflow(part_workflow_id(study_id, part))

    def forget(self, plan_id: str) -> None:
        """Remove all the engine knows of a job, and of messages about it; or of a study, and its parts."""
        found = self._client.list_workflows(workflow_id_prefix=plan_id, load_input=False, load_output=False)
        for workflow_id in {plan_id, *(status.workflow_id for status in found)}:
            self._client.delete_workflow(workflow_id)

    def depth(self, most: int, transaction: sa.Connection | None = None) -> Depth:
        """Return how many jobs wait and run, counted up to `most` each; an index answers without reading a job."""
        counts = (self._count(self._jobs.c.status == status, most) for status in (ENQUEUED, DELAYED, RUNNING))
        query = sa.select(*counts)
        rows = self._database.rows(query) if transaction is None else transaction.execute(query).all()
        return Depth(*rows[0])

    def due_of_owner(self, owner: str, most: int, transaction: sa.Connection) -> int:
        """Return how many jobs of an owner may be begun or run, counted up to `most`."""
        jobs = self._jobs
        due = sa.select(sa.literal(1)).where(self._due, jobs.c.queue_partition_key == owner).limit(most)
        return transaction.scalar(sa.select(sa.func.count()).select_from(due.subquery())) or 0

    def places(self, plan_ids: Sequence[str], most: int, transaction: sa.Connection | None = None) -> dict[str, int]:
        """Return the places in the queue of those of `plan_ids` that are among the first `most` to wait for a worker.

        1 is the next to begin. What others have not committed yet does not count; in `transaction`, what it has does.
        """
        waiting = self._in_turn()
        query = sa.select(waiting.c.workflow_uuid, waiting.c.place).where(
            waiting.c.workflow_uuid.in_(plan_ids), waiting.c.place <= most
        )
        rows = self._database.rows(query) if transaction is None else transaction.execute(query).all()
        return {row.workflow_uuid: row.place for row in rows}

    def pace(self, most: int) -> Pace | None:
        """Return how fast jobs are done; None where none runs, or none of those that were begun last has ended.

        Args:
            most: jobs that run are counted up to it.
        """
        jobs = self._jobs
        columns = jobs.c.status, jobs.c.started_at_epoch_ms, jobs.c.updated_at
        begun = sa.select(*columns).where(jobs.c.queue_name == QUEUE, jobs.c.started_at_epoch_ms.is_not(None))
        latest = begun.order_by(jobs.c.started_at_epoch_ms.desc()).limit(JOBS_TIMED).subquery()
        ended = latest.c.status.in_([status for status, state in STATE_OF_STATUS.items() if state in TIMED])
        mean = sa.select(sa.func.avg(latest.c.updated_at - latest.c.started_at_epoch_ms)).where(ended)
        counted = self._count(jobs.c.status == RUNNING, most).label("running")
        (now,) = self._database.rows(sa.select(counted, mean.scalar_subquery().label("milliseconds")))
        if not now.running or now.milliseconds is None:
            return None
        return Pace(now.running, 1e-3 * float(now.milliseconds))

    def is_next(self, job: sa.ColumnElement[str]) -> sa.ColumnElement[bool]:
        """Return what holds of the id of that job alone which is to be begun next."""
        waiting = self._in_turn()
        return job.in_(sa.select(waiting.c.workflow_uuid).where(waiting.c.place == 1))

    @property
    def _no_verdict(self) -> sa.ColumnElement[bool]:
        """What holds of jobs that have never been put off."""
        return self._jobs.c.priority <= PUT_OFF

    @property
    def _due(self) -> sa.ColumnElement[bool]:
        """What holds of jobs that may be begun, or run."""
        # As the engine's partial indexes have it, word for word: SQLite uses them for nothing else.
        in_flight = self._jobs.c.status.in_([sa.literal_column(f"'{each}'") for each in (ENQUEUED, RUNNING)])
        return sa.and_(self._jobs.c.queue_name == QUEUE, in_flight)

    def _in_turn(self) -> sa.Subquery:
        """Return a query of the ids of all jobs that wait for a worker, with the `place` of each.

        Owners take turns: a job comes as many rounds later as its owner has jobs that run, or wait before it. Within a
        round the owner comes first whose last job was begun longest ago. All of it is read from the engine's indexes.
        Jobs that are put off come after all others, but not for ever.
        """
        jobs, begun = self._jobs, self._jobs.alias("begun")
        of_owner = [jobs.c.priority, jobs.c.created_at, jobs.c.workflow_uuid]
        waiting = (
            sa.select(
                jobs.c.workflow_uuid,
                jobs.c.created_at,
                jobs.c.queue_partition_key.label("owner"),
                sa.and_(sa.not_(self._no_verdict), jobs.c.updated_at > _now_ms() - round(1e3 * PUT_OFF_SECONDS)).label(
                    "put_off"
                ),
                sa.func.row_number().over(partition_by=jobs.c.queue_partition_key, order_by=of_owner).label("ahead"),
            )
            .where(self._due, jobs.c.status == ENQUEUED)
            .cte("waiting")
        )
        running = (
            sa.select(jobs.c.queue_partition_key.label("owner"), sa.func.count().label("number"))
            .where(self._due, jobs.c.status == RUNNING)
            .group_by(jobs.c.queue_partition_key)
            .cte("running")
        )
        latest = (
            sa.select(begun.c.queue_partition_key.label("owner"), begun.c.started_at_epoch_ms)
            .where(begun.c.queue_name == QUEUE, begun.c.started_at_epoch_ms.is_not(None))
            .order_by(begun.c.started_at_epoch_ms.desc())
            .limit(TURNS_REMEMBERED)
            .subquery()
        )
        last = (
            sa.select(latest.c.owner, sa.func.max(latest.c.started_at_epoch_ms).label("begun_ms"))
            .group_by(latest.c.owner)
            .cte("last")
        )
        nobody = sa.literal_column("''")

        def owned(other: sa.CTE) -> sa.ColumnElement[bool]:
            return sa.func.coalesce(other.c.owner, nobody) == sa.func.coalesce(waiting.c.owner, nobody)

        turn = [
            waiting.c.put_off,
            sa.func.coalesce(running.c.number, 0) + waiting.c.ahead,
            sa.func.coalesce(last.c.begun_ms, 0),
            waiting.c.created_at,
            waiting.c.workflow_uuid,
        ]
        return (
            sa.select(waiting.c.workflow_uuid, sa.func.row_number().over(order_by=turn).label("place"))
            .select_from(waiting.outerjoin(running, owned(running)).outerjoin(last, owned(last)))
            .subquery()
        )

    def running(self) -> dict[str, set[str]]:
        """Return the ids of the jobs that were begun and have not ended, by the worker they belong to."""
        query = sa.select(self._jobs.c.executor_id, self._jobs.c.workflow_uuid).where(
            self._jobs.c.queue_name.in_((QUEUE, STUDY_QUEUE, DELIVERY_QUEUE)), self._jobs.c.status == RUNNING
        )
        found: dict[str, set[str]] = {}
        for row in self._database.rows(query):
            found.setdefault(row.executor_id, set()).add(row.workflow_uuid)
        return found

    def another_waits(self) -> bool:
        """Return whether any job that may be begun has no verdict yet."""
        waiting = sa.select(sa.literal(1)).where(self._due, self._jobs.c.status == ENQUEUED, self._no_verdict)
        return bool(self._database.scalar(sa.select(waiting.exists())))

    def put_off(self, worker: str, plan_id: str) -> None:
        """Put a job whose verdict is known back into the queue, if it still belongs to `worker`.

        It comes after all jobs that have no verdict yet, or when it has waited for `PUT_OFF_SECONDS`. Whoever runs it
        at that moment no longer owns it, as after `begin_anew`.
        """
        mine = sa.and_(
            self._jobs.c.workflow_uuid == plan_id,
            self._jobs.c.status == RUNNING,
            self._jobs.c.executor_id == worker,
        )
        changes = {"status": ENQUEUED, "owner_xid": None, "recovery_attempts": 0, "updated_at": _now_ms()}
        later = sa.case((self._no_verdict, self._jobs.c.priority + PUT_OFF), else_=self._jobs.c.priority)
        self._database.write(sa.update(self._jobs).where(mine).values(**changes, priority=later))

    def begin_anew(self, worker: str, plan_ids: Collection[str]) -> int:
        """Put running jobs back into the queue if they still belong to `worker`, and return how many did.

        Whoever runs one of them at that moment no longer owns it: the engine refuses its result.
        """
        if not plan_ids:
            return 0
        taken = (
            sa.update(self._jobs)
            .where(
                self._jobs.c.workflow_uuid.in_(sorted(plan_ids)),
                self._jobs.c.status == RUNNING,
                self._jobs.c.executor_id == worker,
            )
            .values(status=ENQUEUED, owner_xid=None, started_at_epoch_ms=None, updated_at=_now_ms())
        )
        with self._database.engine.begin() as transaction:
            number = transaction.execute(taken).rowcount
            if number:
                add_to_total(transaction, TAKEOVER, count=number)
        return number

    def _errors(self, plan_ids: Sequence[str]) -> dict[str, str]:
        """Return what the engine has stored as the errors of jobs that have failed, by the plan's id."""
        if not plan_ids:
            return {}
        found = self._client.list_workflows(workflow_ids=list(plan_ids), load_input=False)
        return {each.workflow_id: INTERRUPTED_TOO_OFTEN if each.error is None else str(each.error) for each in found}

    def _count(self, state: sa.ColumnElement[bool], most: int) -> sa.ScalarSelect[int]:
        found = sa.select(sa.literal(1)).select_from(self._jobs).where(self._jobs.c.queue_name == QUEUE, state)
        return sa.select(sa.func.count()).select_from(found.limit(most).subquery()).scalar_subquery()


def _now_ms() -> int:
    return time.time_ns() // 1_000_000


def part_workflow_id(study_id: str, part: int) -> str:
    """Return the name of a part's job: it begins with the study's, so that all are forgotten together."""
    return f"{study_id}-part-{part}"


def delivery_workflow_id(plan_id: str, delivery_id: str, number: int) -> str:
    """Return the name of a try: it begins with the plan's, so that both are forgotten together."""
    return f"{plan_id}-{delivery_id}-{number}"


def _job(state: JobState, updated_ms: int | None, error: str | None) -> Job:
    return Job(state, error, None if not state.done or updated_ms is None else updated_ms * 1000)
