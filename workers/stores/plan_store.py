"""What is kept of a plan: its task, its progress, its events and its document."""

from __future__ import annotations

import hashlib
import json
import uuid
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from enum import Enum
from types import MappingProxyType
from typing import Any, Self

import sqlalchemy as sa
from sqlalchemy.exc import IntegrityError

from planners.errors import LiftwrightError
from workers.stores.database import Database
from workers.stores.job_queue import DueJobs, JobQueue, NewJob
from workers.stores.jobs import (
    DELAYED,
    FAILED,
    GIVEN_UP,
    QUEUED,
    RUNNING,
    JobOrder,
    JobState,
    in_state,
    workflow_table,
)
from workers.stores.tables import (
    AUDIT,
    DOCUMENTS,
    EVENTS,
    PLANS,
    STUDIES,
    TOTALS,
    AuditRow,
    Position,
    created_before,
    insert_rows,
    newest_first,
    now_us,
    stored_text,
)
from workers.stores.totals import FAILURE, SOLVER_DEATH, Total, add_to_total, count_document
from workers.stores.webhook_store import expect_deliveries, forget_deliveries

NO_ORDER = JobOrder()


@dataclass(frozen=True, eq=False)
class PackedDocument:
    """A plan document as the solver hands it over."""

    outcome: str
    sha256: str
    """Of the uncompressed JSON."""
    gzip: bytes
    stages: Sequence[tuple[str, float]] = ()
    """Name and seconds of each; one that several objects went through is there for each."""
    complete: bool = True
    """Whether nothing will be added to it; else its simulation, or remedies, are still to come."""
    physics: str | None = None
    """How the plan fared when it was simulated; None: it was not, or not yet."""


@dataclass(frozen=True)
class PlanRecord:
    """One plan without its task and its document."""

    id: str
    kind: str
    owner: str | None
    """Whose key it was posted with; None where no keys were asked for."""
    external_id: str | None
    sent_fingerprint: str | None
    """Hash of the task as sent; None: it was accepted by software that kept none."""
    created_us: int
    """Microseconds since 1970, UTC."""
    started_us: int | None
    finished_us: int | None
    attempts: int
    """How often a solver process began."""
    stage: str | None
    fraction: float
    """How much is done, 0 … 1; never falls."""
    outcome: str | None
    """Of the document, if there is one."""
    work_master: str | None
    priority: int
    start_us: int | None
    end_us: int | None
    certified_us: int | None = None
    """When its document was first stored, of a solved plan; None of those that earlier software has stored."""
    study_id: str | None = None
    """Of the study of which it plans a point, as long as that is kept."""
    physics: str | None = None
    """How it fared when it was simulated; None: it was not, not yet, or stored by earlier software."""


@dataclass(frozen=True)
class PlanFilter:
    """What a plan must be to be listed; None: anything."""

    owner: str | None = None
    kind: str | None = None
    external_id: str | None = None
    work_master: str | None = None
    state: JobState | None = None
    outcome: str | None = None
    """Of a job that has succeeded."""
    physics: str | None = None
    """How it fared when it was simulated."""
    name: str | None = None
    """Part of `external_id` or `work_master`, or the beginning of the id; in capitals or not."""
    from_us: int | None = None
    """Not created before [microseconds since 1970, UTC]."""
    until_us: int | None = None
    """Created before."""

    def conditions(self, dialect: str) -> Iterator[sa.ColumnElement[bool]]:
        """Yield what must hold in a query of plans joined with their documents, on `sqlite` or `postgresql`."""
        wishes = {
            PLANS.c.owner: self.owner,
            PLANS.c.kind: self.kind,
            PLANS.c.external_id: self.external_id,
            PLANS.c.work_master: self.work_master,
            DOCUMENTS.c.outcome: self.outcome,
            DOCUMENTS.c.physics: self.physics,
        }
        yield from (column == wanted for column, wanted in wishes.items() if wanted is not None)
        if self.name is not None:
            named = [
                column.icontains(self.name, autoescape=True) for column in (PLANS.c.external_id, PLANS.c.work_master)
            ]
            yield sa.or_(*named, PLANS.c.id.istartswith(self.name, autoescape=True))
        if self.from_us is not None:
            yield PLANS.c.created_us >= self.from_us
        if self.until_us is not None:
            yield PLANS.c.created_us < self.until_us
        # Before its job has succeeded a document has an outcome that may still be taken back.
        settled = JobState.SUCCEEDED if self.outcome is not None else None
        for state in {state for state in (self.state, settled) if state is not None}:
            jobs = workflow_table(dialect)
            job = sa.select(jobs.c.workflow_uuid).where(jobs.c.workflow_uuid == PLANS.c.id)
            yield job.where(in_state(jobs, state)).exists()


@dataclass(frozen=True, eq=False)
class StoredDocument:
    """A plan document, compressed."""

    gzip: bytes
    sha256: str
    """Of the uncompressed JSON."""


@dataclass(frozen=True, kw_only=True)
class PlanEvent:
    """What became of a plan's job, as whoever follows it is told."""

    event: str | None = None
    """None: progress."""
    attempt: int
    stage: str
    done: int | None = None
    """Parts of the stage, of `total`."""
    total: int | None = None
    fraction: float
    """Of the whole, 0 … 1."""
    outcome: str | None = None

    def text(self) -> str:
        """Return it as JSON."""
        return json.dumps({name: value for name, value in vars(self).items() if value is not None})


@dataclass(frozen=True, eq=False)
class Submission:
    """A task that was checked, with all that is to be stored of it."""

    record: PlanRecord
    """As it is once it is stored."""
    row: Mapping[str, Any]
    """Of the table of plans."""
    order: JobOrder
    audit: AuditRow | None
    """Row of the audit log; None: nothing is kept there."""
    delayed: bool
    """Whether its job may not be begun yet."""

    @classmethod
    def of(
        cls,
        task: Mapping[str, Any],
        owner: str | None = None,
        order: JobOrder = NO_ORDER,
        idempotency_key: str | None = None,
        sent_fingerprint: str | None = None,
        audit: Callable[[str], AuditRow] | None = None,
        *,
        study_id: str | None = None,
    ) -> Self:
        """Put together what is stored of a task; `audit` makes the row of the audit log, given the plan's id."""
        plan_id, now = uuid.uuid4().hex, now_us()
        shared = {
            "id": plan_id,
            "created_us": now,
            "kind": task["kind"],
            "external_id": stored_text(task.get("external_id")),
            "owner": owner,
            "sent_fingerprint": sent_fingerprint,
            "attempts": 0,
            "fraction": 0.0,
            "work_master": stored_text(order.work_master),
            "priority": order.priority,
            "start_us": order.start_us,
            "end_us": order.end_us,
            "study_id": study_id,
        }
        row = {
            **shared,
            "idempotency_key": stored_key(idempotency_key, owner),
            # For the version before, which compares this one.
            "fingerprint": fingerprint(task),
            "task": json.dumps(task),
            "scene_id": task.get("scene_id"),
            "cell": stored_text(task.get("cell")),
        }
        record = PlanRecord(**shared, started_us=None, finished_us=None, stage=None, outcome=None)
        return cls(record, row, order, None if audit is None else audit(plan_id), order.pause(now) > 0.0)

    @property
    def plan_id(self) -> str:
        """The id that the plan will have."""
        return self.record.id

    @property
    def owner(self) -> str | None:
        """To whom it will belong."""
        return self.record.owner

    @property
    def key(self) -> str | None:
        """The caller's key as it is stored; None: it gave none."""
        return self.row["idempotency_key"]

    @property
    def cell(self) -> str:
        """As the task names it."""
        return self.row["cell"]

    @property
    def job(self) -> NewJob:
        """What is enqueued."""
        start_us = self.order.start_us if self.delayed else None
        return NewJob(self.plan_id, self.record.created_us, self.owner, self.order.priority, start_us)


@dataclass(frozen=True)
class Accepted:
    """A plan that a submission has made, or that the same key made before."""

    record: PlanRecord
    place: int | None
    """In the queue: 1 is the next to begin; None: it is not new, waits for its start, or is too far behind to count."""
    is_new: bool


class NoRoom(Enum):
    """Why a task was not accepted that could be planned."""

    QUEUE_FULL = "there are too many unfinished jobs"
    SHARE_FULL = "there are too many unfinished jobs of its owner"
    TOO_MANY_DELAYED = "too many jobs of its owner wait for their start"


@dataclass(frozen=True)
class Room:
    """For how many jobs there is room."""

    jobs: int
    """That may be begun, and have not ended."""
    jobs_of_owner: int
    """As many of them as one owner may have, where keys tell owners apart."""
    delayed: int
    """Of one owner that wait for their start."""


class KeyTaken(LiftwrightError):
    """A plan cannot be stored, though no other one has its key."""

    def __init__(self, plan_id: str) -> None:
        super().__init__(f"the plan {plan_id} could not be stored: what it is stored under is taken")


WHY_OF_STATUS = MappingProxyType({FAILED: "error", GIVEN_UP: "interruptions"})
"""Why a job has failed if no solver said so and none was stopped, by the engine's word for its end."""
EVERYTHING = PlanFilter()
_OF_DOCUMENTS = ("outcome", "certified_us", "physics")
"""Members of a record that are columns of documents."""
_COLUMNS: list[sa.ColumnElement[Any]] = [
    *(PLANS.c[each.name] for each in fields(PlanRecord) if each.name not in (*_OF_DOCUMENTS, "priority")),
    *(DOCUMENTS.c[name] for name in _OF_DOCUMENTS),
    sa.func.coalesce(PLANS.c.priority, 0).label("priority"),
]
_RECORDS = sa.select(*_COLUMNS).select_from(PLANS.outerjoin(DOCUMENTS, DOCUMENTS.c.plan_id == PLANS.c.id))


class PlanStore:
    """Reads and writes plans. Every method is one transaction."""

    def __init__(self, database: Database) -> None:
        self._database = database
        self._jobs = workflow_table(database.engine.dialect.name)

    def accept_all(
        self, submissions: Sequence[Submission], queue: JobQueue, room: Room | None = None
    ) -> list[Accepted | NoRoom]:
        """Store tasks with what is kept of their requests and enqueue their jobs, all in one transaction.

        The same key of an owner again returns the plan it made, without its place, once that cannot be lost. The
        owner's webhooks that want to know of all plans are told when a job ends, and the one that is named by its
        order. The caller compares `sent_fingerprint`, of what it was sent before defaults were filled in, to learn
        whether the key was used for another task.

        Args:
            submissions: no key of an owner more than once.
            queue: takes the jobs.
            room: how many jobs there may be; None: any number.
        """
        try:
            with self._database.engine.begin() as transaction:
                answers = self._accept(transaction, submissions, queue, room)
        except IntegrityError:
            # Another process has stored a plan under one of the keys since they were looked up.
            if not any(each.key for each in submissions):
                raise
        else:
            accepted = [each for each in answers if isinstance(each, Accepted)]
            if accepted and not any(each.is_new for each in accepted):
                # Nothing was written: these were stored by requests that may have had no answer.
                self._database.confirm()
            return answers
        if len(submissions) > 1:
            return [accepted for each in submissions for accepted in self.accept_all([each], queue, room)]
        known = self._by_keys([submissions[0].key or ""])
        if not known:
            raise KeyTaken(submissions[0].plan_id)
        self._database.confirm()
        return [Accepted(record, None, is_new=False) for record in known.values()]

    def _accept(
        self, transaction: sa.Connection, submissions: Sequence[Submission], queue: JobQueue, room: Room | None
    ) -> list[Accepted | NoRoom]:
        """Do what `accept_all` says, up to the commit."""
        keys = [each.key for each in submissions if each.key is not None]
        known = self._by_keys(keys, transaction) if keys else {}
        wanted = [each for each in submissions if each.key is None or each.key not in known]
        due = None if room is None else queue.due(transaction)
        refused = {} if room is None or due is None else self._refused(transaction, wanted, due, room)
        new = [each for each in wanted if each.plan_id not in refused]
        if new:
            # In the same order in every process: of two that insert the same keys each would wait for the other.
            insert_rows(transaction, PLANS, [each.row for each in sorted(new, key=lambda each: each.key or "")])
            queue.enqueue(transaction, [each.job for each in new])
            expect_deliveries(transaction, [(each.plan_id, each.owner, each.order.webhook_id) for each in new])
            audited = [each.audit for each in new if each.audit is not None]
            if audited:
                insert_rows(transaction, AUDIT, audited)
        places = {} if due is None else due.places([each.job for each in new if not each.delayed])
        return [
            Accepted(known[each.key], None, is_new=False)
            if each.key is not None and each.key in known
            else refused.get(each.plan_id) or Accepted(each.record, places.get(each.plan_id), is_new=True)
            for each in submissions
        ]

    def _refused(
        self, transaction: sa.Connection, submissions: Sequence[Submission], due: DueJobs, room: Room
    ) -> dict[str, NoRoom]:
        """Return for which submissions there is no room any more beside the jobs that are due, and why."""
        shares, refused = due.of_owners(), dict[str, NoRoom]()
        delayed: dict[str | None, int] = {}
        for each in submissions:
            if shares.total() >= room.jobs:
                refused[each.plan_id] = NoRoom.QUEUE_FULL
            elif each.owner is not None and shares[each.owner] >= room.jobs_of_owner:
                refused[each.plan_id] = NoRoom.SHARE_FULL
            elif not each.delayed:
                shares[each.owner] += 1
            else:
                # Jobs for later are in nobody's way, so they are no reason to refuse those of others.
                if each.owner not in delayed:
                    delayed[each.owner] = self.delayed(each.owner, room.delayed, transaction)
                if delayed[each.owner] >= room.delayed:
                    refused[each.plan_id] = NoRoom.TOO_MANY_DELAYED
                delayed[each.owner] += 1
        return refused

    def get(self, plan_id: str) -> PlanRecord | None:
        """Return one plan."""
        return self._one(_RECORDS.where(PLANS.c.id == plan_id))

    def by_key(self, idempotency_key: str | None, owner: str | None = None) -> PlanRecord | None:
        """Return the plan that a key of an owner made, once that cannot be lost; None without a key."""
        key = stored_key(idempotency_key, owner)
        known = None if key is None else self._by_keys([key]).get(key)
        if known is not None:
            self._database.confirm()
        return known

    def _by_keys(self, keys: Sequence[str], transaction: sa.Connection | None = None) -> dict[str, PlanRecord]:
        """Return the plans that keys made, by key as it is stored."""
        query = _RECORDS.add_columns(PLANS.c.idempotency_key).where(PLANS.c.idempotency_key.in_(keys))
        rows = self._database.mappings(query) if transaction is None else transaction.execute(query).mappings().all()
        found = [dict(row) for row in rows]
        return {row.pop("idempotency_key"): PlanRecord(**row) for row in found}

    def newest(self, most: int, before: Position | None, wanted: PlanFilter = EVERYTHING) -> list[PlanRecord]:
        """Return at most `most` of the wanted plans, newest first, from behind the one at `before`."""
        query = newest_first(_RECORDS, PLANS, most, before)
        query = query.where(*wanted.conditions(self._database.engine.dialect.name))
        return [PlanRecord(**row) for row in self._database.mappings(query)]

    def naming_scene(self, scene_id: str) -> list[str]:
        """Return the ids of the plans whose tasks name a scene."""
        return self._database.column(sa.select(PLANS.c.id).where(PLANS.c.scene_id == scene_id))

    def task(self, plan_id: str) -> dict[str, Any] | None:
        """Return a plan's task as accepted."""
        text = self._database.scalar(sa.select(PLANS.c.task).where(PLANS.c.id == plan_id))
        return None if text is None else json.loads(text)

    def begin_attempt(self, plan_id: str) -> PlanRecord | None:
        """Count one more attempt; None if the plan was deleted, or its job has ended.

        Its number is the right to write: what an earlier attempt still says, on a worker that was given up for dead, is
        dropped.
        """
        begun = self._unended(plan_id).values(
            attempts=PLANS.c.attempts + 1,
            started_us=sa.func.coalesce(PLANS.c.started_us, now_us()),
            finished_us=None,
        )
        with self._database.engine.begin() as transaction:
            if transaction.execute(begun).rowcount == 0:
                return None
            # Inside: another worker may begin the next attempt as soon as this is over.
            return PlanRecord(**transaction.execute(_RECORDS.where(PLANS.c.id == plan_id)).mappings().one())

    def count_crash(self, plan_id: str) -> int:
        """Count one more death of the plan's solver process, and return how many there were."""
        with self._database.engine.begin() as transaction:
            add_to_total(transaction, SOLVER_DEATH)
            transaction.execute(sa.update(PLANS).where(PLANS.c.id == plan_id).values(crashes=PLANS.c.crashes + 1))
            return transaction.scalar(sa.select(PLANS.c.crashes).where(PLANS.c.id == plan_id)) or 0

    def add_event(self, plan_id: str, event: PlanEvent) -> None:
        """Append an event and show it as the plan's progress.

        Nothing happens unless its `attempt` is the newest, and the job has not ended.
        """
        with self._database.engine.begin() as transaction:
            self._add_event(transaction, plan_id, event)

    def events_after(self, plan_id: str, sequence: int) -> list[tuple[int, dict[str, Any]]]:
        """Return the events behind `sequence`, oldest first."""
        query = (
            sa.select(EVENTS.c.sequence, EVENTS.c.event)
            .where(EVENTS.c.plan_id == plan_id, EVENTS.c.sequence > sequence)
            .order_by(EVENTS.c.sequence)
        )
        return [(row.sequence, json.loads(row.event)) for row in self._database.rows(query)]

    def last_event(self, plan_id: str) -> int:
        """Return the number of the newest event; 0 if there is none."""
        return self.last_events([plan_id]).get(plan_id, 0)

    def last_events(self, plan_ids: Sequence[str]) -> dict[str, int]:
        """Return the number of the newest event of each of some plans; one without events is left out."""
        newest = sa.func.max(EVENTS.c.sequence).label("newest")
        query = sa.select(EVENTS.c.plan_id, newest).where(EVENTS.c.plan_id.in_(plan_ids)).group_by(EVENTS.c.plan_id)
        return {row.plan_id: row.newest for row in self._database.rows(query)}

    def save_certified(
        self,
        plan_id: str,
        document: PackedDocument,
        event: PlanEvent,
        tell: Callable[[sa.Connection], None],
    ) -> None:
        """Store a certified document that more will be added to, until `save_document` replaces it.

        Nothing happens unless the event's `attempt` is the newest, and the job has not ended; all of it or nothing.

        Args:
            plan_id: of which plan.
            document: without a simulation, or without remedies.
            event: as for `add_event`; appended.
            tell: has whoever wants to know be told, in the same transaction.
        """
        with self._database.engine.begin() as transaction:
            if not self._add_event(transaction, plan_id, event):
                return
            transaction.execute(sa.delete(DOCUMENTS).where(DOCUMENTS.c.plan_id == plan_id))
            certified_us = now_us() if document.outcome == "solved" else None
            stored = _document(plan_id, document).values(certified_us=certified_us, awaits_simulation=True)
            transaction.execute(stored)
            tell(transaction)

    def save_document(self, plan_id: str, attempt: int, document: PackedDocument) -> bool:
        """Store a document and count its stages; False if the job has ended or a newer attempt has begun.

        All of it or nothing: a document that can be read is whole. What an earlier life of the same attempt stored is
        replaced, and so is the document without a simulation.
        """
        mine = DOCUMENTS.c.plan_id == plan_id
        with self._database.engine.begin() as transaction:
            finished = self._attempt(plan_id, attempt).values(finished_us=now_us())
            if transaction.execute(finished).rowcount == 0:
                return False
            known = sa.select(DOCUMENTS.c.certified_us, DOCUMENTS.c.awaits_simulation).where(mine)
            before = transaction.execute(known).one_or_none()
            transaction.execute(sa.delete(DOCUMENTS).where(mine))
            certified_us = before.certified_us if before else now_us() if document.outcome == "solved" else None
            transaction.execute(_document(plan_id, document).values(certified_us=certified_us))
            if before is None or before.awaits_simulation:
                count_document(transaction, document.outcome, document.stages)
        return True

    def outcome(self, plan_id: str) -> str | None:
        """Return the outcome of a plan's document, if there is one to which nothing is added any more."""
        final = sa.and_(DOCUMENTS.c.plan_id == plan_id, sa.not_(DOCUMENTS.c.awaits_simulation))
        return self._database.scalar(sa.select(DOCUMENTS.c.outcome).where(final))

    def certified(self, plan_id: str) -> bytes | None:
        """Return the certified document, as gzip, that more will be added to; None: there is none."""
        awaiting = sa.and_(DOCUMENTS.c.plan_id == plan_id, DOCUMENTS.c.awaits_simulation)
        return self._database.scalar(sa.select(DOCUMENTS.c.gzip).where(awaiting))

    def overdue(self, time_us: int, most: int) -> list[str]:
        """Return the ids of plans whose jobs have not ended and should have by a time, most overdue first."""
        jobs = self._jobs
        late = (
            sa.select(PLANS.c.id)
            .join(jobs, jobs.c.workflow_uuid == PLANS.c.id)
            .where(jobs.c.status.in_((*QUEUED, RUNNING)), PLANS.c.end_us <= time_us)
        )
        return self._database.column(late.order_by(PLANS.c.end_us).limit(most))

    def mark_overdue(self, plan_ids: Sequence[str]) -> None:
        """Keep the time as the end of those that have none."""
        ending = sa.update(PLANS).where(PLANS.c.id.in_(plan_ids), PLANS.c.finished_us.is_(None))
        self._database.write(ending.values(finished_us=now_us()))

    def mark_finished(self, plan_id: str) -> None:
        """Keep the time: the engine's own, on SQLite, is a whole second."""
        self._database.write(sa.update(PLANS).where(PLANS.c.id == plan_id).values(finished_us=now_us()))

    def mark_failed(self, plan_id: str, attempt: int, why: str) -> bool:
        """Keep the time and count the failure; False if the job has ended or a newer attempt has begun."""
        with self._database.engine.begin() as transaction:
            if transaction.execute(self._attempt(plan_id, attempt).values(finished_us=now_us())).rowcount == 0:
                return False
            add_to_total(transaction, FAILURE, why)
        return True

    def count_failures(self, most: int) -> list[str]:
        """Count jobs that the engine has ended as failed with no word from here, and return the ids of their plans.

        Each is counted once, however often it is asked: a plan whose end is kept has been counted.
        """
        jobs = self._jobs
        begun = sa.func.coalesce(PLANS.c.started_us, PLANS.c.created_us)
        uncounted = (
            sa.select(PLANS.c.id, jobs.c.status, jobs.c.updated_at, begun.label("begun_us"))
            .join(jobs, jobs.c.workflow_uuid == PLANS.c.id)
            .where(jobs.c.status.in_(tuple(WHY_OF_STATUS)), PLANS.c.finished_us.is_(None))
            # In one order everywhere, so that two workers never wait for each other.
            .order_by(PLANS.c.id)
            .limit(most)
        )
        counted: list[str] = []
        with self._database.engine.begin() as transaction:
            why = Counter[str]()
            for row in transaction.execute(uncounted).all():
                ending = sa.update(PLANS).where(PLANS.c.id == row.id, PLANS.c.finished_us.is_(None))
                # As the engine has it, which on SQLite is a whole second: the plan is shown as before.
                ended_us = max(row.updated_at * 1000, row.begun_us)
                if transaction.execute(ending.values(finished_us=ended_us)).rowcount:
                    why[WHY_OF_STATUS[row.status]] += 1
                    counted.append(row.id)
            # After all plans: who has a count locked waits for nobody's plan.
            for label in sorted(why):
                add_to_total(transaction, FAILURE, label, count=why[label])
        return counted

    def document(self, plan_id: str) -> StoredDocument | None:
        """Return a plan's document."""
        query = sa.select(DOCUMENTS.c.gzip, DOCUMENTS.c.sha256).where(DOCUMENTS.c.plan_id == plan_id)
        found = self._database.mappings(query)
        return StoredDocument(**found[0]) if found else None

    def outcome_counts(self) -> dict[str, int]:
        """Return how many documents there are of each outcome."""
        query = sa.select(DOCUMENTS.c.outcome, sa.func.count().label("number")).group_by(DOCUMENTS.c.outcome)
        return {row.outcome: row.number for row in self._database.rows(query)}

    def totals(self) -> list[Total]:
        """Return what all workers have counted."""
        query = sa.select(TOTALS).order_by(TOTALS.c.name, TOTALS.c.label)
        return [Total(**row) for row in self._database.mappings(query)]

    def created_before(self, time_us: int, after: Position, most: int) -> list[Position]:
        """Return (created_us, id) of plans accepted before a time, oldest first, from behind `after`."""
        query = created_before(PLANS, time_us, after, most)
        return [(row.created_us, row.id) for row in self._database.rows(query)]

    def delete(self, plan_id: str) -> None:
        """Remove a plan with all that belongs to it."""
        with self._database.engine.begin() as transaction:
            transaction.execute(sa.delete(PLANS).where(PLANS.c.id == plan_id))
            transaction.execute(sa.delete(EVENTS).where(EVENTS.c.plan_id == plan_id))
            transaction.execute(sa.delete(DOCUMENTS).where(DOCUMENTS.c.plan_id == plan_id))
            best_of_study = sa.update(STUDIES).where(STUDIES.c.best_plan_id == plan_id)
            transaction.execute(best_of_study.values(best_plan_id=None))
            forget_deliveries(transaction, plan_id)

    def delayed(self, owner: str | None, most: int, transaction: sa.Connection | None = None) -> int:
        """Return how many jobs of an owner wait for their start, counted up to `most`."""
        jobs = self._jobs
        waiting = (
            sa.select(sa.literal(1))
            .select_from(PLANS.join(jobs, jobs.c.workflow_uuid == PLANS.c.id))
            .where(jobs.c.status == DELAYED, PLANS.c.owner.is_not_distinct_from(owner))
        )
        query = sa.select(sa.func.count()).select_from(waiting.limit(most).subquery())
        return (self._database.scalar(query) if transaction is None else transaction.scalar(query)) or 0

    def _one(self, query: sa.Select[Any]) -> PlanRecord | None:
        found = self._database.mappings(query)
        return PlanRecord(**found[0]) if found else None

    def _add_event(self, transaction: sa.Connection, plan_id: str, event: PlanEvent) -> bool:
        """Do what `add_event` says; False if nothing happened."""
        shown = self._attempt(plan_id, event.attempt).values(stage=event.stage, fraction=event.fraction)
        if transaction.execute(shown).rowcount == 0:
            return False
        next_sequence = sa.select(sa.func.coalesce(sa.func.max(EVENTS.c.sequence), 0) + 1)
        sequence = transaction.scalar(next_sequence.where(EVENTS.c.plan_id == plan_id))
        row = {"plan_id": plan_id, "sequence": sequence, "event": event.text()}
        transaction.execute(sa.insert(EVENTS).values(row))
        return True

    def _attempt(self, plan_id: str, attempt: int) -> sa.Update:
        """Return an update of a plan that touches nothing once its job has ended or a newer attempt has begun."""
        return self._unended(plan_id).where(PLANS.c.attempts == attempt)

    def _unended(self, plan_id: str) -> sa.Update:
        """Return an update of a plan that touches nothing once its job has ended.

        A worker learns late of a job that was cancelled. The engine's row is locked meanwhile, so that nobody who was
        told of the end sees the plan change after that.
        """
        jobs = self._jobs
        going_on = sa.select(jobs.c.workflow_uuid).where(
            jobs.c.workflow_uuid == plan_id, jobs.c.status.in_((*QUEUED, RUNNING))
        )
        return sa.update(PLANS).where(PLANS.c.id == plan_id, sa.exists(going_on.with_for_update(read=True)))


def stored_key(idempotency_key: str | None, owner: str | None) -> str | None:
    """Return what stands for a key in the database: two owners may choose the same one."""
    if idempotency_key is None or owner is None:
        return idempotency_key
    return hashlib.sha256(f"{owner}\0{idempotency_key}".encode()).hexdigest()


def _document(plan_id: str, document: PackedDocument) -> sa.Insert:
    """Return what stores a document, with values to be added."""
    packed = {
        "outcome": document.outcome,
        "sha256": document.sha256,
        "gzip": document.gzip,
        "physics": document.physics,
    }
    return sa.insert(DOCUMENTS).values(plan_id=plan_id, **packed)


def fingerprint(task: Any) -> str:
    """Return a hash that two tasks as JSON data share only if they are equal, in whatever order their members are."""
    return hashlib.sha256(json.dumps(task, sort_keys=True).encode()).hexdigest()
