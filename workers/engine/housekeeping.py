"""What every worker does now and then for all of them: cancels what is overdue, counts failures, forgets what is old.

Any number of workers may do so at once: what is done is done.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import sqlalchemy as sa
import structlog

from workers.stores.cell_store import CellStore
from workers.stores.database import Database
from workers.stores.job_queue import JobQueue
from workers.stores.jobs import Job
from workers.stores.plan_store import PlanStore
from workers.stores.scene_store import SceneStore
from workers.stores.study_store import StudyStore
from workers.stores.tables import AUDIT, Position, now_us

BATCH = 100
DELETION_PAUSE_SECONDS = 3600.0
"""Between two rounds of deletion [s]."""
US_PER_DAY = 86_400_000_000

log = structlog.get_logger(__name__)


def cancel_overdue(store: PlanStore, queue: JobQueue) -> None:
    """Cancel jobs that have not ended by the end of their order: whoever ordered them has no use for their plans."""
    overdue = store.overdue(now_us(), BATCH)
    if not overdue:
        return
    # First, so that a job which is seen to be cancelled is seen with what it was cancelled by.
    store.mark_overdue(overdue)
    for plan_id in overdue:
        queue.cancel(plan_id)
    # A worker may have begun it in between, and taken its end away.
    store.mark_overdue(overdue)
    log.info("jobs cancelled at the end of their time", job_ids=overdue)


def count_failures(store: PlanStore) -> None:
    """Count jobs that the engine has given up or seen end by an error, with nobody there to say so."""
    failed = store.count_failures(BATCH)
    if failed:
        log.error("jobs failed without a solver's word", job_ids=failed)


def clear_cells(cells: CellStore) -> None:
    """Forget deleted cells that nothing is in, and remove the files of this machine that belong to no cell."""
    forgotten, cleared = cells.forget_deleted(), cells.clear_folder()
    if forgotten or cleared:
        log.info("cells forgotten", cells=forgotten, folders=cleared)


def delete_old(store: PlanStore, scenes: SceneStore, studies: StudyStore, queue: JobQueue, days: float) -> int:
    """Delete every plan that ended more than so many days ago, and return how many there were.

    Studies go likewise. Scenes that were last posted before then go too, unless a plan that is left names them. Meshes
    stay, since tasks may name them for ever.
    """
    before = now_us() - round(days * US_PER_DAY)

    def delete_plan(plan_id: str) -> None:
        # In this order: a plan without a job is found again by the next round.
        queue.forget(plan_id)
        store.delete(plan_id)

    gone = _delete_ended(store.created_before, queue.jobs, delete_plan, before)
    studies_gone = _delete_ended(studies.created_before, studies.jobs, studies.delete, before)
    scenes_gone = scenes.delete_before(before)
    if gone or scenes_gone or studies_gone:
        log.info("old plans deleted", plans=gone, studies=studies_gone, scenes=scenes_gone, days=days)
    return gone


def delete_old_audit(database: Database, days: float) -> int:
    """Delete every entry of the audit log from more than so many days ago, and return how many there were."""
    before = now_us() - round(days * US_PER_DAY)
    with database.engine.begin() as transaction:
        gone = transaction.execute(sa.delete(AUDIT).where(AUDIT.c.at_us < before)).rowcount
    if gone:
        log.info("old entries of the audit log deleted", entries=gone, days=days)
    return gone


def _delete_ended(
    created_before: Callable[[int, Position, int], Sequence[Position]],
    jobs: Callable[[Sequence[str]], Mapping[str, Job]],
    delete: Callable[[str], None],
    before: int,
) -> int:
    """Delete whatever was created and has ended before a time, batch by batch, and return how much there was."""
    position, gone = (0, ""), 0
    while batch := created_before(before, position, BATCH):
        position = batch[-1]
        known = jobs([each for _, each in batch])
        for _, each in batch:
            job = known.get(each)
            if job is None or (job.state.done and (job.ended_us or 0) < before):
                delete(each)
                gone += 1
    return gone
