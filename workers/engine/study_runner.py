"""One part of a study from its begin to its end. A point that is known is not examined again, whatever has died."""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Sequence
from functools import partial

import structlog

from planners.study.study import Study
from planners.study.study_map import StudyPoint, best_of
from workers.engine.running_jobs import JobLeft, RunningJobs
from workers.settings import WorkerSettings
from workers.solver.examiner_pool import ExaminerPool
from workers.solver.pool import SolverDied, SolverFault
from workers.solver.protocol import StudyRequest
from workers.stores.database_loss import once_it_is_there
from workers.stores.job_queue import JobQueue, part_workflow_id
from workers.stores.study_store import StudyRecord, StudyStore, points_of_part
from workers.stores.task_parts import TaskParts

log = structlog.get_logger(__name__)


class StudyRunner:
    """Runs parts of studies on the running event loop, as many at a time as the engine hands it."""

    def __init__(
        self, settings: WorkerSettings, queue: JobQueue, studies: StudyStore, parts: TaskParts, pool: ExaminerPool
    ) -> None:
        self._settings, self._queue, self._studies, self._parts = settings, queue, studies, parts
        self._pool = pool
        self._slots = asyncio.Semaphore(settings.study_slots)
        self.jobs = RunningJobs[None]()
        """Those that have a process now, or wait for one."""

    async def run(self, study_id: str, part: int) -> str:
        """Examine the points of one part that are not known yet.

        Raises:
            JobLeft: It is not this worker's any more.
        """
        study = await once_it_is_there(self._studies.study, study_id)
        record = await once_it_is_there(self._studies.get, study_id)
        if study is None or record is None or not await once_it_is_there(self._studies.begin, study_id):
            raise JobLeft(study_id)
        parts = await once_it_is_there(self._parts.named_by, study.with_each_value())
        job_id, deaths = part_workflow_id(study_id, part), Counter[int]()
        async with self._slots:
            while missing := await self._missing(record, part):
                if await once_it_is_there(self._queue.not_with, self._settings.executor_name, [job_id]):
                    raise JobLeft(job_id)
                request = StudyRequest(study.document(), missing, parts.meshes, parts.cell_folders)
                await self._examine(job_id, record, study, request, deaths)
        await self._plan_best(record, study)
        return "examined"

    async def _missing(self, record: StudyRecord, part: int) -> list[int]:
        known = await once_it_is_there(self._studies.known, record.id)
        return [index for index in points_of_part(record.count, part) if index not in known]

    async def _examine(
        self, job_id: str, record: StudyRecord, study: Study, request: StudyRequest, deaths: Counter[int]
    ) -> None:
        """Have points examined one after the other; of one at which that fails too often it is told, and no more."""
        left, limit = list(request.points), self._settings.solver_seconds
        try:
            async with asyncio.timeout(limit) as time:

                async def keep(document: dict[str, object]) -> None:
                    # However long the database is away, that is not the solver's time.
                    time.reschedule(None)
                    point = StudyPoint.model_validate(document)
                    if not await once_it_is_there(self._studies.add_point, record.id, point):
                        raise JobLeft(record.id)
                    left.remove(point.index)
                    # Each point has as long as a job has.
                    time.reschedule(asyncio.get_running_loop().time() + limit)

                await self.jobs.run(job_id, partial(self._pool.examine, request, keep))
        except TimeoutError:
            why = f"the solver was stopped after {limit:g} s, the longest it may take (LIFTWRIGHT_SOLVER_SECONDS)"
            await self._give_up(record, study, left, why)
        except SolverFault as fault:
            await self._give_up(record, study, left, str(fault))
        except SolverDied as death:
            index = left[0] if left else -1
            deaths[index] += 1
            log.warning("solver died", job_id=job_id, point=index, deaths=deaths[index], ending=str(death))
            if deaths[index] >= self._settings.crash_limit:
                await self._give_up(record, study, left, f"given up after {deaths[index]} attempts: {death}")

    async def _give_up(self, record: StudyRecord, study: Study, left: Sequence[int], why: str) -> None:
        """Keep the point that was being examined as failed; those behind it are examined without it."""
        if left:
            log.warning("point failed", study_id=record.id, point=left[0], why=why)
            point = StudyPoint.without_plan(study, left[0], "failed", why, 0.0)
            await once_it_is_there(self._studies.add_point, record.id, point)

    async def _plan_best(self, record: StudyRecord, study: Study) -> None:
        """Once all points are known, have the best one planned and certified; asked again, it finds that plan."""
        if (await once_it_is_there(self._studies.counts, [record.id])).get(record.id) != record.count:
            return
        best = best_of(await once_it_is_there(self._studies.points, record.id))
        if best is not None:
            await once_it_is_there(self._studies.plan_best, record, study, best.index)
        log.info("study done", study_id=record.id, points=record.count, best=None if best is None else best.index)
