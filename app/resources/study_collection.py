"""Studies with their points: what the routes ask for, put together from the store and the queue."""

from __future__ import annotations

from collections.abc import Callable, Container
from typing import Any

from pydantic import ValidationError

from app.access.caller import ANYBODY, Caller, Scope
from app.errors import (
    AlreadyFinished,
    KeyUsedForAnotherTask,
    NotFinished,
    PointNotFound,
    StudyNotFound,
    TooManyStudies,
)
from app.resources.plan_collection import PlanCollection
from app.resources.queries import page_of
from app.resources.schemas import PlanResource, StudyResource, study_resource
from app.settings import ServiceSettings
from app.task_intake import VersionedCells
from planners.contract.problems import Problem, reasons_of
from planners.contract.study_spec import StudyAxis
from planners.errors import SceneError
from planners.study.study import NotAStudy, Study
from planners.study.study_map import StudyMap
from workers.stores.job_queue import JobQueue
from workers.stores.jobs import Job
from workers.stores.plan_store import fingerprint
from workers.stores.study_store import StudyRecord, StudyStore
from workers.stores.tables import Position

CELL = "/cell"
"""Pointer into a task."""


class StudyCollection:
    """What one caller sees of all studies: what belongs to somebody else does not exist.

    All methods block on the database: call them from a thread.
    """

    def __init__(
        self,
        store: StudyStore,
        queue: JobQueue,
        plans: PlanCollection,
        settings: ServiceSettings,
        caller: Caller = ANYBODY,
    ) -> None:
        self.store, self._queue, self._plans, self._settings, self._caller = store, queue, plans, settings, caller

    def seen_by(self, caller: Caller) -> StudyCollection:
        """Return what another caller sees."""
        return StudyCollection(self.store, self._queue, self._plans.seen_by(caller), self._settings, caller)

    def submit(
        self, sent: Any, fill: Callable[[Any], Any], idempotency_key: str | None, cells: VersionedCells
    ) -> StudyResource:
        """Accept a study, or find the one that the same key made.

        Args:
            sent: the study as JSON data, as it came.
            fill: puts into its task what that takes from a perceived scene.
            idempotency_key: of the caller, if it has one.
            cells: that its task may name.

        Raises:
            NotAStudy: What is wrong with it.
            TooManyStudies: There are too many unfinished studies, or too many of the caller's.
            KeyUsedForAnotherTask: The key was used for another study.
        """
        sent_fingerprint = fingerprint(sent)
        record = self.store.by_key(idempotency_key, self._caller.owner)
        if record is None:
            study = Study.read(sent, fill, self._settings.max_study_points)
            study = _in_lasting_cells(study, cells)
            self._require_room()
            record = self.store.accept(study, idempotency_key, self._caller.owner, sent_fingerprint)
        # Somebody else may have used the key just now.
        if record.sent_fingerprint != sent_fingerprint and not self._asks_for(record, sent, fill, cells):
            raise KeyUsedForAnotherTask
        return self._resources([record])[0]

    def _asks_for(self, record: StudyRecord, sent: Any, fill: Callable[[Any], Any], cells: VersionedCells) -> bool:
        """Tell whether a study is the same as another one, in other words."""
        study = _in_lasting_cells(Study.read(sent, fill, self._settings.max_study_points), cells)
        stored = self.store.study(record.id)
        return stored is not None and stored.document() == study.document()

    def _require_room(self) -> None:
        unfinished, owner = self._queue.unfinished_studies(), self._caller.owner
        most, most_own = self._settings.max_studies, self._settings.max_studies_of_owner
        if unfinished.total() >= most:
            raise TooManyStudies(most)
        if owner is not None and unfinished[owner] >= most_own:
            raise TooManyStudies(most_own, own=True)

    def study(self, study_id: str) -> StudyResource:
        """Return one study.

        Raises:
            StudyNotFound: There is none of that id.
        """
        found = self._resources([self._record(study_id)])
        if not found:
            raise StudyNotFound(study_id)
        return found[0]

    def page(self, size: int, before: Position | None) -> tuple[list[StudyResource], Position | None]:
        """Return at most `size` studies, newest first, from behind a position, and where the next page begins."""
        owner = None if self._caller.scope is Scope.ADMIN else self._caller.owner
        shown, position = page_of(self.store.newest(size + 1, before, owner), size)
        return self._resources(shown), position

    def map(self, study_id: str) -> StudyMap:
        """Return what is known of a study so far.

        Raises:
            StudyNotFound: There is none of that id.
        """
        _, study = self._accepted(study_id)
        return StudyMap.of(study, self.store.points(study_id))

    def plan_point(self, study_id: str, index: int, cells: Container[str]) -> PlanResource:
        """Have a point planned and certified, or find the plan that was made of it.

        Args:
            study_id: of the study.
            index: of the point.
            cells: that there are, those among them that are deleted and still kept.

        Raises:
            StudyNotFound: There is no study of that id.
            PointNotFound: It has no such point, or there can be no such task any more.
            QueueFull: There are too many unfinished jobs.
            ShareFull: There are too many of the study's owner.
        """
        record, study = self._accepted(study_id)
        if not 0 <= index < study.count:
            raise PointNotFound(f"the study has the points 0 to {study.count - 1}, not {index}")
        made = self.store.plan_of_point(record, index)
        if made is not None:
            return self._plans.plan(made.id)
        point = next((point for point in self.store.points(study_id) if point.index == index), None)
        if point is not None and point.outcome == "refused":
            raise PointNotFound(f"there can be no plan of point {index}: {point.summary}")
        try:
            submission = self.store.submission(record, study, index)
        except (ValidationError, SceneError) as error:
            raise PointNotFound(f"there can be no plan of point {index}: {reasons_of(error)}") from error
        if submission.cell not in cells:
            raise PointNotFound(f"there can be no plan of point {index}: there is no cell {submission.cell} any more")
        return self._plans.admit(submission)

    def cancel(self, study_id: str) -> StudyResource:
        """Cancel what is left of a study; its points that are known stay.

        Raises:
            StudyNotFound: There is none of that id.
            AlreadyFinished: It has ended, be it just now.
        """
        study = self.study(study_id)
        if study.done:
            raise AlreadyFinished(study.state)
        self.store.cancel(self._record(study_id))
        study = self.study(study_id)
        if study.done and study.state != "cancelled":
            raise AlreadyFinished(study.state)
        return study

    def delete(self, study_id: str) -> None:
        """Remove a study with its points; plans that were made of points stay.

        Raises:
            StudyNotFound: There is none of that id.
            NotFinished: It has not ended.
        """
        study = self.study(study_id)
        if not study.done:
            raise NotFinished(study.state)
        self.store.delete(study_id)

    def _record(self, study_id: str) -> StudyRecord:
        record = self.store.get(study_id)
        if record is None or not self._caller.may_see(record.owner):
            raise StudyNotFound(study_id)
        return record

    def _accepted(self, study_id: str) -> tuple[StudyRecord, Study]:
        record, study = self._record(study_id), self.store.study(study_id)
        if study is None:
            raise StudyNotFound(study_id)
        return record, study

    def _resources(self, records: list[StudyRecord]) -> list[StudyResource]:
        # The states before the points: those of a study that has ended are complete.
        jobs = self._queue.study_jobs({record.id: record.parts for record in records})
        known = self.store.counts([record.id for record in records])
        return [
            study_resource(self._as_of(record, job), job, known.get(record.id, 0))
            for record in records
            if (job := jobs.get(record.id)) is not None
        ]

    def _as_of(self, record: StudyRecord, job: Job) -> StudyRecord:
        """Return a record that is no older than what is known of its job."""
        ended_since = job.state.done and (record.finished_us is None or record.best_plan_id is None)
        return (self.store.get(record.id) if ended_since else None) or record


def _in_lasting_cells(study: Study, cells: VersionedCells) -> Study:
    """Return a study whose points name cells for good, as its task does already.

    Raises:
        NotAStudy: It names cells that are not there, or not for this caller.
    """
    allowed, lasting = list(cells), list[StudyAxis]()
    named = [(f"/task{CELL}", str(study.spec.task["cell"]))]
    for number, axis in enumerate(study.axes):
        if axis.pointer == CELL:
            names = [str(value) for value in axis.places]
            named += [(f"/axes/{number}/values/{place}", name) for place, name in enumerate(names)]
            axis = axis.model_copy(update={"values": tuple(map(cells.lasting_name, names))})
        lasting.append(axis)
    problems = [Problem(where, f"there is no cell {name}", allowed) for where, name in named if name not in cells]
    if problems:
        raise NotAStudy(problems)
    return Study(study.spec.model_copy(update={"axes": tuple(lasting)}))
