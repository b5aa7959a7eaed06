"""The engine as seen from outside: enqueue, look, cancel, forget. Works without running any job itself."""

from __future__ import annotations

import json
import time
import uuid
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import sqlalchemy as sa
from dbos import DBOSClient, EnqueueOptions, WorkflowSerializationFormat
from sqlalchemy import exc

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
from workers.stores.tables import DELIVERIES, DELIVERY_ATTEMPTS, insert_rows
from workers.stores.totals import TAKEOVER, add_to_total

QUEUE = "plans"
WORKFLOW = "plan"
STUDY_QUEUE = "studies"
STUDY_WORKFLOW = "examine"
DELIVERY_QUEUE = "webhooks"
DELIVERY_WORKFLOW = "deliver"
DELIVERIES_AT_ONCE = 16
LEAST_POLL_SECONDS = 0.5
"""Between two looks for what may wait a moment: parts of studies, and messages [s]."""
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
PUT_OFF_SINCE = "put_off_since_ms"
"""Name of a parameter of a query."""
FORGOTTEN_AT_ONCE = 500
"""So many jobs are removed in one transaction [1]."""
COUNTED_MS = 1000
"""So long whoever takes jobs over waits to count them [ms]."""
LOCK_NOT_AVAILABLE = "55P03"
"""SQLSTATE of a statement that has waited as long as it may for what another one has locked."""
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

    Beside them it takes parts of studies and messages of webhooks: nobody's plan waits until a study is done, and a
    study or a message may wait for a moment.
    """
    seldom = max(poll_seconds, LEAST_POLL_SECONDS)
    return {
        QUEUE: QueueLook(worker_slots, poll_seconds),
        STUDY_QUEUE: QueueLook(study_slots, seldom),
        DELIVERY_QUEUE: QueueLook(DELIVERIES_AT_ONCE, seldom),
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

    @property
    def engine_priority(self) -> int:
        """As the engine counts: the other way, from 1."""
        return 1 + HIGHEST_PRIORITY - self.priority

    @property
    def order(self) -> tuple[int, int, str]:
        """By which its owner's jobs go, the least first."""
        return self.engine_priority, self.created_us // 1000, self.plan_id


@dataclass(frozen=True)
class DueJobs:
    """How many jobs may be begun or run, by what it depends on whose turn is when."""

    waiting: Mapping[str | None, Mapping[int, int]]
    """How many wait for their turn, by owner and the engine's priority: not those that are put off."""
    running: Mapping[str | None, int]
    """How many run, by owner."""
    put_off: Mapping[str | None, int]
    """How many are put off, by owner."""
    begun_ms: Mapping[str | None, int]
    """When the last job was begun, by owner; of the owners that is known of [milliseconds since 1970, UTC]."""

    def of_owners(self) -> Counter[str | None]:
        """Return how many each owner has."""
        waiting = {owner: sum(numbers.values()) for owner, numbers in self.waiting.items()}
        return Counter(waiting) + Counter(self.running) + Counter(self.put_off)

    def places(self, new: Sequence[NewJob]) -> dict[str, int]:
        """Return the places in the queue of jobs that join it now, as `JobQueue.places` finds them by sorting it.

        It is asked for each task that is accepted, so it takes counts alone: whatever waits already is older. Of jobs
        that others add at the same time, and of several that an owner had put off too long ago, the order may differ.
        """
        rank = {job.plan_id: self._rank(job, new) for job in new}
        rounds = {(job.owner, rank[job.plan_id]): job for job in new}
        numbers = Counter({owner: sum(waiting.values()) for owner, waiting in self.waiting.items()})
        numbers.update(job.owner for job in new)
        places: dict[str, int] = {}
        for job in new:
            turn, place = self.running.get(job.owner, 0) + rank[job.plan_id], rank[job.plan_id]
            for other, number in numbers.items():
                if other == job.owner:
                    continue
                # Those of the rounds before, and perhaps the one of the same round.
                its_rank = turn - self.running.get(other, 0)
                place += min(max(its_rank - 1, 0), number)
                if 1 <= its_rank <= number:
                    place += self._goes_first(other, rounds.get((other, its_rank)), job)
            places[job.plan_id] = place
        return places

    def _rank(self, job: NewJob, new: Sequence[NewJob]) -> int:
        """Return the how manyth of its owner's jobs that wait one is that joins them with others, from 1."""
        older = self.waiting.get(job.owner, {}).items()
        before = sum(number for priority, number in older if priority <= job.engine_priority)
        return 1 + before + sum(other.owner == job.owner and other.order < job.order for other in new)

    def _goes_first(self, owner: str | None, other: NewJob | None, job: NewJob) -> bool:
        """Whether another owner's job goes before one of the same round; None: that one waits already."""
        theirs, ours = self.begun_ms.get(owner, 0), self.begun_ms.get(job.owner, 0)
        if theirs != ours or other is None:
            return theirs <= ours
        return other.order[1:] < job.order[1:]


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
        # Put together once: they are asked for each task that is accepted.
        self._last_begun = self._last_turns()
        self._due_counts = self._counts_of_due()

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
        """Enqueue jobs; they exist when `transaction` commits."""
        self._insert(transaction, QUEUE, WORKFLOW, [(job.plan_id, (job.plan_id,), job) for job in jobs])

    def enqueue_parts(self, transaction: sa.Connection, study: NewJob, parts: int) -> None:
        """Enqueue all parts of a study; they exist when `transaction` commits.

        Args:
            transaction: that stores the study.
            study: under its own id, as if it was a job.
            parts: how many [1].
        """
        rows = [(part_workflow_id(study.plan_id, part), (study.plan_id, part), study) for part in range(parts)]
        self._insert(transaction, STUDY_QUEUE, STUDY_WORKFLOW, rows)

    def _insert(
        self,
        transaction: sa.Connection,
        queue: str,
        workflow: str,
        new: Sequence[tuple[str, tuple[str | int, ...], NewJob]],
    ) -> None:
        """Write rows as the engine would write them: it takes one job at a time, with two statements compiled anew.

        Args:
            transaction: with which they come to be there.
            queue: that they wait in.
            workflow: that they are run by.
            new: of each row its id, what its workflow is called with, and the rest.
        """
        rows = [
            {
                "workflow_uuid": workflow_id,
                "status": ENQUEUED if job.start_us is None else DELAYED,
                "name": workflow,
                "queue_name": queue,
                # The engine has an index of what waits and runs by it, and makes no other use of it in these queues.
                "queue_partition_key": job.owner,
                "application_name": APPLICATION,
                "application_version": APPLICATION_VERSION,
                "serialization": PORTABLE_JSON,
                "priority": job.engine_priority,
                "recovery_attempts": 0,
                "creator_xid": str(uuid.uuid4()),
                "delay_until_epoch_ms": None if job.start_us is None else job.start_us // 1000,
                "created_at": job.created_us // 1000,
                "updated_at": job.created_us // 1000,
            }
            for workflow_id, _, job in new
        ]
        inputs = [
            {
                "workflow_uuid": workflow_id,
                "inputs": json.dumps({"namedArgs": {}, "positionalArgs": [*arguments]}, separators=(",", ":")),
                "retention_timestamp": job.created_us // 1000,
            }
            for workflow_id, arguments, job in new
        ]
        insert_rows(transaction, self._jobs, rows)
        insert_rows(transaction, self._inputs, inputs)

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

    def unfinished_studies(self) -> Counter[str | None]:
        """Return how many studies of each owner have parts that have not ended."""
        study = sa.func.substr(self._jobs.c.workflow_uuid, 1, STUDY_ID_LENGTH)
        unfinished = sa.select(study.label("study"), self._jobs.c.queue_partition_key.label("owner")).where(
            self._jobs.c.queue_name == STUDY_QUEUE, self._jobs.c.status.in_((*QUEUED, RUNNING))
        )
        return Counter({row.study: row.owner for row in self._database.rows(unfinished.distinct())}.values())

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
        """Remove all the engine knows of a job, and of messages about it: before the plan, by which they are found."""
        self._client.delete_workflows([*self._tries(DELIVERIES.c.plan_id == plan_id), plan_id])

    def forget_study(self, study_id: str, parts: int) -> None:
        """Remove all the engine knows of the parts of a study."""
        self._client.delete_workflows([part_workflow_id(study_id, part) for part in range(parts)])

    def forget_webhook(self, webhook_id: str) -> None:
        """Remove all the engine knows of messages to a webhook: before the webhook, whose log tells them."""
        tries = self._tries(DELIVERIES.c.webhook_id == webhook_id)
        for first in range(0, len(tries), FORGOTTEN_AT_ONCE):
            self._client.delete_workflows(tries[first : first + FORGOTTEN_AT_ONCE])

    def _tries(self, whose: sa.ColumnElement[bool]) -> list[str]:
        """Return the names of all tries of some messages."""
        tried = sa.func.coalesce(sa.func.max(DELIVERY_ATTEMPTS.c.number), 0).label("tried")
        messages = (
            sa.select(DELIVERIES.c.id, DELIVERIES.c.plan_id, tried)
            .join(DELIVERY_ATTEMPTS, DELIVERY_ATTEMPTS.c.delivery_id == DELIVERIES.c.id, isouter=True)
            .where(whose)
            .group_by(DELIVERIES.c.id, DELIVERIES.c.plan_id)
        )
        # With each try that fails the next one is enqueued.
        return [
            delivery_workflow_id(message.plan_id, message.id, number)
            for message in self._database.rows(messages)
            for number in range(1, message.tried + 2)
        ]

    def depth(self, most: int, queue: str = QUEUE) -> Depth:
        """Return how many jobs of a queue wait and run, up to `most` each; an index answers without reading a job."""
        counts = (self._count(self._jobs.c.status == status, most, queue) for status in (ENQUEUED, DELAYED, RUNNING))
        return Depth(*self._database.rows(sa.select(*counts))[0])

    def due(self, transaction: sa.Connection) -> DueJobs:
        """Return how many jobs may be begun or run, and who had the last turns."""
        waiting: dict[str | None, dict[int, int]] = {}
        running, put_off = dict[str | None, int](), Counter[str | None]()
        for row in transaction.execute(self._due_counts, {PUT_OFF_SINCE: _put_off_since_ms()}):
            if row.status == RUNNING:
                running[row.owner] = running.get(row.owner, 0) + row.number
            elif row.put_off:
                put_off[row.owner] += row.number
            else:
                waiting.setdefault(row.owner, {})[row.priority] = row.number
        begun = {row.owner: row.begun_ms for row in transaction.execute(self._last_begun)}
        return DueJobs(waiting, running, put_off, begun)

    def places(self, plan_ids: Sequence[str], most: int) -> dict[str, int]:
        """Return the places in the queue of those of `plan_ids` that are among the first `most` to wait for a worker.

        1 is the next to begin. What is not committed yet does not count.
        """
        waiting = self._in_turn()
        query = sa.select(waiting.c.workflow_uuid, waiting.c.place).where(
            waiting.c.workflow_uuid.in_(plan_ids), waiting.c.place <= most
        )
        return {row.workflow_uuid: row.place for row in self._database.rows(query)}

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

    def is_next(self, job: sa.ColumnElement[str], queue: str = QUEUE) -> sa.ColumnElement[bool]:
        """Return what holds of the id of that job alone which is to be begun next, of plans or of parts of studies."""
        waiting = self._in_turn(queue)
        return job.in_(sa.select(waiting.c.workflow_uuid).where(waiting.c.place == 1))

    @property
    def _no_verdict(self) -> sa.ColumnElement[bool]:
        """What holds of jobs that have never been put off."""
        return self._jobs.c.priority <= PUT_OFF

    def _due(self, queue: str = QUEUE) -> sa.ColumnElement[bool]:
        """Return what holds of jobs of a queue that may be begun, or run."""
        # As the engine's partial indexes have it, word for word: SQLite uses them for nothing else.
        in_flight = self._jobs.c.status.in_([sa.literal_column(f"'{each}'") for each in (ENQUEUED, RUNNING)])
        return sa.and_(self._jobs.c.queue_name == queue, in_flight)

    def _in_turn(self, queue: str = QUEUE) -> sa.Subquery:
        """Return a query of the ids of all jobs of a queue that wait for a worker, with the `place` of each.

        Owners take turns: a job comes as many rounds later as its owner has jobs that run, or wait before it. Within a
        round the owner comes first whose last job was begun longest ago. All of it is read from the engine's indexes.
        Jobs that are put off come after all others, but not for ever.
        """
        jobs, put_off = self._jobs, self._is_put_off(sa.literal(_put_off_since_ms()))
        of_owner = [self._priority(put_off), jobs.c.created_at, jobs.c.workflow_uuid]
        waiting = (
            sa.select(
                jobs.c.workflow_uuid,
                jobs.c.created_at,
                jobs.c.queue_partition_key.label("owner"),
                put_off.label("put_off"),
                sa.func.row_number().over(partition_by=jobs.c.queue_partition_key, order_by=of_owner).label("ahead"),
            )
            .where(self._due(queue), jobs.c.status == ENQUEUED)
            .cte("waiting")
        )
        running = (
            sa.select(jobs.c.queue_partition_key.label("owner"), sa.func.count().label("number"))
            .where(self._due(queue), jobs.c.status == RUNNING)
            .group_by(jobs.c.queue_partition_key)
            .cte("running")
        )
        last = self._last_turns(queue).cte("last")
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

    def _counts_of_due(self) -> sa.Select[Any]:
        """Return a query of how many jobs may be begun or run, by what `DueJobs` tells apart."""
        jobs = self._jobs
        put_off = self._is_put_off(sa.bindparam(PUT_OFF_SINCE, type_=sa.BigInteger))
        priority = self._priority(put_off).label("priority")
        kinds = jobs.c.queue_partition_key.label("owner"), jobs.c.status, priority, put_off.label("put_off")
        counts = sa.select(*kinds, sa.literal(1).label("one")).where(self._due()).subquery()
        columns = [counts.c[each.name] for each in kinds]
        return sa.select(*columns, sa.func.count().label("number")).group_by(*columns)

    def _last_turns(self, queue: str = QUEUE) -> sa.Select[Any, Any]:
        """Return a query of when the last job of each owner was begun, of those of a queue that were begun last."""
        begun = self._jobs.alias("begun")
        latest = (
            sa.select(begun.c.queue_partition_key.label("owner"), begun.c.started_at_epoch_ms)
            .where(begun.c.queue_name == queue, begun.c.started_at_epoch_ms.is_not(None))
            .order_by(begun.c.started_at_epoch_ms.desc())
            .limit(TURNS_REMEMBERED)
            .subquery()
        )
        begun_ms = sa.func.max(latest.c.started_at_epoch_ms).label("begun_ms")
        return sa.select(latest.c.owner, begun_ms).group_by(latest.c.owner)

    def _is_put_off(self, since_ms: sa.ColumnElement[int]) -> sa.ColumnElement[bool]:
        """Return what holds of jobs that come after all others, because they were put off after a time."""
        return sa.and_(sa.not_(self._no_verdict), self._jobs.c.updated_at > since_ms)

    def _priority(self, put_off: sa.ColumnElement[bool]) -> sa.ColumnElement[int]:
        """Return the priority of a job, the least first: of one that was put off long enough, that of before."""
        was_put_off = sa.and_(sa.not_(self._no_verdict), sa.not_(put_off))
        return sa.case((was_put_off, self._jobs.c.priority - PUT_OFF), else_=self._jobs.c.priority)

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
        waiting = sa.select(sa.literal(1)).where(self._due(), self._jobs.c.status == ENQUEUED, self._no_verdict)
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

        Whoever runs one of them at that moment no longer owns it: the engine refuses its result. One that is being
        written is left for the next time, and so are all while they cannot be counted: a process that was frozen within
        a transaction holds its rows until the server ends the session, and who waits for that cannot prove meanwhile
        that it lives itself.
        """
        if not plan_ids:
            return 0
        lost = (
            sa.select(self._jobs.c.workflow_uuid)
            .where(
                self._jobs.c.workflow_uuid.in_(sorted(plan_ids)),
                self._jobs.c.status == RUNNING,
                self._jobs.c.executor_id == worker,
            )
            .with_for_update(skip_locked=True)
        )
        taken = (
            sa.update(self._jobs)
            .where(self._jobs.c.workflow_uuid.in_(lost))
            .values(status=ENQUEUED, owner_xid=None, started_at_epoch_ms=None, updated_at=_now_ms())
        )
        try:
            with self._database.engine.begin() as transaction:
                if transaction.dialect.name == "postgresql":
                    transaction.execute(sa.select(sa.func.set_config("lock_timeout", f"{COUNTED_MS}ms", True)))
                number = transaction.execute(taken).rowcount
                if number:
                    add_to_total(transaction, TAKEOVER, count=number)
                return number
        except exc.OperationalError as error:
            if getattr(error.orig, "sqlstate", None) != LOCK_NOT_AVAILABLE:
                raise
            return 0

    def _errors(self, plan_ids: Sequence[str]) -> dict[str, str]:
        """Return what the engine has stored as the errors of jobs that have failed, by the plan's id."""
        if not plan_ids:
            return {}
        found = self._client.list_workflows(workflow_ids=list(plan_ids), load_input=False)
        return {each.workflow_id: INTERRUPTED_TOO_OFTEN if each.error is None else str(each.error) for each in found}

    def _count(self, state: sa.ColumnElement[bool], most: int, queue: str = QUEUE) -> sa.ScalarSelect[int]:
        found = sa.select(sa.literal(1)).select_from(self._jobs).where(self._jobs.c.queue_name == queue, state)
        return sa.select(sa.func.count()).select_from(found.limit(most).subquery()).scalar_subquery()


def _now_ms() -> int:
    return time.time_ns() // 1_000_000


def _put_off_since_ms() -> int:
    """Return since when a job must have been put off to still be so."""
    return _now_ms() - round(1e3 * PUT_OFF_SECONDS)


def part_workflow_id(study_id: str, part: int) -> str:
    """Return the name of a part's job: it begins with the study's."""
    return f"{study_id}-part-{part}"


def delivery_workflow_id(plan_id: str, delivery_id: str, number: int) -> str:
    """Return the name of a try: it begins with the plan's."""
    return f"{plan_id}-{delivery_id}-{number}"


def _job(state: JobState, updated_ms: int | None, error: str | None) -> Job:
    return Job(state, error, None if not state.done or updated_ms is None else updated_ms * 1000)
