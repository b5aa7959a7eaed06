"""What is kept of a study: what was accepted, and every point from the moment it is known."""

from __future__ import annotations

import json
import uuid
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import sqlalchemy as sa
from sqlalchemy.exc import IntegrityError

from planners.contract.task_spec import read_task, write_task
from planners.study.study import Study
from planners.study.study_map import StudyPoint
from workers.stores.database import Database
from workers.stores.job_queue import JobQueue, NewJob
from workers.stores.jobs import Job
from workers.stores.plan_store import Accepted, PlanRecord, PlanStore, Submission, stored_key
from workers.stores.tables import PLANS, STUDIES, STUDY_POINTS, Position, created_before, newest_first, now_us
from workers.stores.totals import STUDY_POINT, add_to_total

POINTS_PER_PART = 12
"""A part is what one solver process takes at a time [1]."""


@dataclass(frozen=True)
class StudyRecord:
    """One study without its task and its points."""

    id: str
    kind: str
    """Of its task."""
    owner: str | None
    """Whose key it was posted with; None where no keys were asked for."""
    external_id: str | None
    sent_fingerprint: str
    created_us: int
    """Microseconds since 1970, UTC."""
    started_us: int | None
    finished_us: int | None
    count: int
    """How many points it has."""
    parts: int
    best_plan_id: str | None
    """Of the plan of the best point, once all points are known and one is solved."""


_STUDIES = sa.select(*(STUDIES.c[each.name] for each in fields(StudyRecord)))


def parts_of(count: int) -> int:
    """Return how many parts a study with so many points has."""
    return -(-count // POINTS_PER_PART)


def points_of_part(count: int, part: int) -> range:
    """Return the numbers of the points of one part, of a study with so many."""
    return range(part * POINTS_PER_PART, min(count, (part + 1) * POINTS_PER_PART))


class StudyStore:
    """Reads and writes studies. Every method is one transaction."""

    def __init__(self, database: Database, plans: PlanStore, queue: JobQueue) -> None:
        self._database, self._plans, self._queue = database, plans, queue

    def accept(
        self, study: Study, idempotency_key: str | None, owner: str | None, sent_fingerprint: str
    ) -> StudyRecord:
        """Store a study and enqueue its parts, all or nothing.

        The same key of an owner again returns what it made, once that cannot be lost.
        """
        known = self.by_key(idempotency_key, owner)
        if known is not None:
            return known
        values = {
            "id": uuid.uuid4().hex,
            "created_us": now_us(),
            "kind": study.spec.task["kind"],
            "external_id": study.spec.external_id,
            "owner": owner,
            "idempotency_key": stored_key(idempotency_key, owner),
            "sent_fingerprint": sent_fingerprint,
            "study": json.dumps(study.document()),
            "count": study.count,
            "parts": parts_of(study.count),
        }
        try:
            with self._database.engine.begin() as transaction:
                transaction.execute(sa.insert(STUDIES).values(values))
                self._queue.enqueue_parts(
                    transaction, NewJob(values["id"], values["created_us"], owner), values["parts"]
                )
        except IntegrityError:
            known = self.by_key(idempotency_key, owner)
            if known is None:
                raise
            return known
        record = self.get(values["id"])
        assert record is not None
        return record

    def get(self, study_id: str) -> StudyRecord | None:
        """Return one study."""
        return self._one(_STUDIES.where(STUDIES.c.id == study_id))

    def by_key(self, idempotency_key: str | None, owner: str | None) -> StudyRecord | None:
        """Return the study that a key of an owner made, once that cannot be lost; None without a key."""
        if idempotency_key is None:
            return None
        known = self._one(_STUDIES.where(STUDIES.c.idempotency_key == stored_key(idempotency_key, owner)))
        if known is not None:
            self._database.confirm()
        return known

    def newest(self, most: int, before: Position | None, owner: str | None) -> list[StudyRecord]:
        """Return at most `most` studies, of one owner or of all, newest first, from behind the one at `before`."""
        query = newest_first(_STUDIES, STUDIES, most, before)
        if owner is not None:
            query = query.where(STUDIES.c.owner == owner)
        return [StudyRecord(**row) for row in self._database.mappings(query)]

    def study(self, study_id: str) -> Study | None:
        """Return a study as accepted."""
        text = self._database.scalar(sa.select(STUDIES.c.study).where(STUDIES.c.id == study_id))
        return None if text is None else Study.of_document(json.loads(text))

    def begin(self, study_id: str) -> bool:
        """Keep the time at which a study was begun first; False if it was deleted, or cancelled before."""
        # One whose points are all known may still have to plan the best of them.
        open_or_begun = sa.or_(STUDIES.c.finished_us.is_(None), STUDIES.c.started_us.is_not(None))
        beginning = sa.update(STUDIES).where(STUDIES.c.id == study_id, open_or_begun)
        started = sa.func.coalesce(STUDIES.c.started_us, now_us())
        return self._database.write(beginning.values(started_us=started)) > 0

    def known(self, study_id: str) -> set[int]:
        """Return the numbers of the points that are known."""
        return set(self._database.column(sa.select(STUDY_POINTS.c.number).where(STUDY_POINTS.c.study_id == study_id)))

    def counts(self, study_ids: Sequence[str]) -> dict[str, int]:
        """Return how many points of each study are known; one without any is left out."""
        return self.last_events(study_ids)

    def points(self, study_id: str) -> list[StudyPoint]:
        """Return the points that are known, by number."""
        query = sa.select(STUDY_POINTS.c.point).where(STUDY_POINTS.c.study_id == study_id)
        found = self._database.column(query.order_by(STUDY_POINTS.c.number))
        return [StudyPoint.model_validate_json(text) for text in found]

    def add_point(self, study_id: str, point: StudyPoint) -> bool:
        """Keep a point; False if the study was deleted, or has ended. One that is known stays as it is."""
        # The row is locked, so that points have numbers without gaps, whoever adds them, and none comes behind the end.
        unended = STUDIES.c.id == study_id, STUDIES.c.finished_us.is_(None)
        owned = sa.update(STUDIES).where(*unended).values(count=STUDIES.c.count)
        of_study = STUDY_POINTS.c.study_id == study_id
        with self._database.engine.begin() as transaction:
            if transaction.execute(owned).rowcount == 0:
                return False
            known = sa.select(STUDY_POINTS.c.number).where(of_study, STUDY_POINTS.c.number == point.index)
            if transaction.scalar(known) is not None:
                return True
            last = transaction.scalar(sa.select(sa.func.max(STUDY_POINTS.c.sequence)).where(of_study)) or 0
            row = {
                "study_id": study_id,
                "number": point.index,
                "sequence": last + 1,
                "outcome": point.outcome,
                "point": point.model_dump_json(),
            }
            transaction.execute(sa.insert(STUDY_POINTS).values(row))
            whole = sa.update(STUDIES).where(STUDIES.c.id == study_id, STUDIES.c.count == last + 1)
            transaction.execute(whole.values(finished_us=now_us()))
            add_to_total(transaction, STUDY_POINT, point.outcome, seconds=point.seconds)
        return True

    def submission(self, record: StudyRecord, study: Study, index: int) -> Submission:
        """Return the task of a point as it is submitted for a plan of the study's owner; once accepted it is found."""
        task = write_task(read_task(study.document_at(index)))
        return Submission.of(task, record.owner, idempotency_key=point_key(record.id, index), study_id=record.id)

    def plan_best(self, record: StudyRecord, study: Study, index: int) -> None:
        """Accept the task of the best point as a plan, and keep which it is; both happen once only.

        However many jobs there are: nobody would ask again.
        """
        (accepted,) = self._plans.accept_all([self.submission(record, study, index)], self._queue)
        assert isinstance(accepted, Accepted)
        best = sa.update(STUDIES).where(STUDIES.c.id == record.id)
        self._database.write(best.values(best_plan_id=accepted.record.id))

    def plan_of_point(self, record: StudyRecord, index: int) -> PlanRecord | None:
        """Return the plan of a point, if it was asked for."""
        return self._plans.by_key(point_key(record.id, index), record.owner)

    # What a feed asks for: the points are the events.

    def jobs(self, study_ids: Sequence[str]) -> dict[str, Job]:
        """Return how studies stand, all their parts together; one that does not exist is left out."""
        rows = self._database.rows(sa.select(STUDIES.c.id, STUDIES.c.parts).where(STUDIES.c.id.in_(study_ids)))
        return self._queue.study_jobs({row.id: row.parts for row in rows})

    def last_events(self, study_ids: Sequence[str]) -> dict[str, int]:
        """Return the number of the newest event of each of some studies; one without events is left out."""
        newest = sa.func.max(STUDY_POINTS.c.sequence).label("newest")
        of_studies = sa.select(STUDY_POINTS.c.study_id, newest).where(STUDY_POINTS.c.study_id.in_(study_ids))
        return {row.study_id: row.newest for row in self._database.rows(of_studies.group_by(STUDY_POINTS.c.study_id))}

    def events_after(self, study_id: str, sequence: int) -> list[tuple[int, dict[str, Any]]]:
        """Return the points that came behind `sequence`, in the order in which they did."""
        query = (
            sa.select(STUDY_POINTS.c.sequence, STUDY_POINTS.c.point)
            .where(STUDY_POINTS.c.study_id == study_id, STUDY_POINTS.c.sequence > sequence)
            .order_by(STUDY_POINTS.c.sequence)
        )
        return [(row.sequence, json.loads(row.point)) for row in self._database.rows(query)]

    def cancel(self, record: StudyRecord) -> None:
        """Cancel all parts that have not ended."""
        self._queue.cancel_study(record.id, record.parts)
        ending = sa.update(STUDIES).where(STUDIES.c.id == record.id, STUDIES.c.finished_us.is_(None))
        self._database.write(ending.values(finished_us=now_us()))

    def created_before(self, time_us: int, after: Position, most: int) -> list[Position]:
        """Return (created_us, id) of studies accepted before a time, oldest first, from behind `after`."""
        query = created_before(STUDIES, time_us, after, most)
        return [(row.created_us, row.id) for row in self._database.rows(query)]

    def delete(self, study_id: str) -> None:
        """Remove a study with its points and its jobs; plans that were made of points stay."""
        # Its jobs first: a study without jobs is found again by whoever deletes what is old.
        for row in self._database.rows(sa.select(STUDIES.c.parts).where(STUDIES.c.id == study_id)):
            self._queue.forget_study(study_id, row.parts)
        with self._database.engine.begin() as transaction:
            transaction.execute(sa.delete(STUDIES).where(STUDIES.c.id == study_id))
            transaction.execute(sa.delete(STUDY_POINTS).where(STUDY_POINTS.c.study_id == study_id))
            transaction.execute(sa.update(PLANS).where(PLANS.c.study_id == study_id).values(study_id=None))

    def _one(self, query: sa.Select[Any]) -> StudyRecord | None:
        found = self._database.mappings(query)
        return StudyRecord(**found[0]) if found else None


def point_key(study_id: str, index: int) -> str:
    """Return the key under which the plan of a point is known; with its blanks, no caller can send it."""
    return f"study {study_id} point {index}"
