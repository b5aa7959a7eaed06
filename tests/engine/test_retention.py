"""Old plans are forgotten, whole; what has not ended, or not for so long, stays."""

from __future__ import annotations

import uuid

import sqlalchemy as sa

from planners.contract.scene_document import SceneDocument
from planners.perception.perceive import PerceivedScene
from tests.support.accepted import accept
from tests.support.service import task
from workers.engine.housekeeping import BATCH, US_PER_DAY, delete_old, delete_old_audit
from workers.stores.database import Database
from workers.stores.job_queue import JobQueue
from workers.stores.jobs import workflow_table
from workers.stores.plan_store import PackedDocument, PlanEvent, PlanStore, now_us
from workers.stores.scene_store import SceneStore
from workers.stores.study_store import StudyStore
from workers.stores.tables import AUDIT, DOCUMENTS, EVENTS, PLANS, SCENES


def make(database: Database, queue: JobQueue, *, age_days: float, ended_days: float | None) -> str:
    """Accept a plan so many days ago, which ended so many days ago or has not ended."""
    store, jobs = PlanStore(database), workflow_table("sqlite")
    plan_id = accept(store, task(), None, queue).id
    store.add_event(plan_id, PlanEvent(attempt=0, stage="search", fraction=0.5))
    store.save_document(plan_id, 0, PackedDocument("solved", "0" * 64, b"x"))
    with database.engine.begin() as transaction:
        accepted = now_us() - round(age_days * US_PER_DAY)
        transaction.execute(sa.update(PLANS).where(PLANS.c.id == plan_id).values(created_us=accepted))
        if ended_days is not None:
            ended_ms = (now_us() - round(ended_days * US_PER_DAY)) // 1000
            end = sa.update(jobs).where(jobs.c.workflow_uuid == plan_id)
            transaction.execute(end.values(status="SUCCESS", updated_at=ended_ms, completed_at=ended_ms))
    return plan_id


def studies_of(database: Database, queue: JobQueue) -> StudyStore:
    return StudyStore(database, PlanStore(database), queue)


def test_only_what_ended_before_is_deleted_with_all_that_belongs_to_it(database: Database, queue: JobQueue) -> None:
    old = make(database, queue, age_days=12, ended_days=11)
    kept = [
        make(database, queue, age_days=12, ended_days=9),
        make(database, queue, age_days=12, ended_days=None),
        make(database, queue, age_days=1, ended_days=1),
    ]
    store = PlanStore(database)
    assert delete_old(store, SceneStore(database), studies_of(database, queue), queue, days=10) == 1
    assert delete_old(store, SceneStore(database), studies_of(database, queue), queue, days=10) == 0
    assert store.get(old) is None
    assert old not in queue.jobs([old])
    with database.engine.connect() as connection:
        for table in (EVENTS, DOCUMENTS):
            assert set(connection.scalars(sa.select(table.c.plan_id))) == set(kept)


def keep_scene(database: Database, *, posted_days: float, created_days: float = 30.0) -> str:
    """Keep a scene that was first posted, and last posted, so many days ago."""
    document = SceneDocument(
        cell="dual_ur3e_tool", external_id=None, tool=None, table=None, objects=(), unrecognised=(), notes=()
    )
    scene_id = uuid.uuid4().hex
    SceneStore(database).add(scene_id, PerceivedScene(document, b"", None))
    created, posted = (now_us() - round(days * US_PER_DAY) for days in (created_days, posted_days))
    with database.engine.begin() as transaction:
        kept = sa.update(SCENES).where(SCENES.c.id == scene_id)
        transaction.execute(kept.values(created_us=created, posted_us=posted))
    return scene_id


def test_scenes_go_that_were_last_posted_before_and_that_no_plan_names(database: Database, queue: JobQueue) -> None:
    posted_again = keep_scene(database, posted_days=9)
    gone, of_finished, of_unfinished = (keep_scene(database, posted_days=11) for _ in range(3))
    ended = make(database, queue, age_days=12, ended_days=11)
    waits = make(database, queue, age_days=12, ended_days=None)
    with database.engine.begin() as transaction:
        for plan_id, scene_id in ((ended, of_finished), (waits, of_unfinished)):
            transaction.execute(sa.update(PLANS).where(PLANS.c.id == plan_id).values(scene_id=scene_id))
    scenes = SceneStore(database)
    assert delete_old(PlanStore(database), scenes, studies_of(database, queue), queue, days=10) == 1
    assert {scene.id for scene in scenes.newest(10, None)} == {posted_again, of_unfinished}
    assert scenes.get(gone) is None
    scenes.touch(posted_again)
    assert delete_old(PlanStore(database), scenes, studies_of(database, queue), queue, days=1) == 0
    assert scenes.get(posted_again) is not None


def test_a_plan_is_kept_with_the_scene_that_its_task_names(database: Database, queue: JobQueue) -> None:
    scene_id, store = "5" * 32, PlanStore(database)
    plan = accept(store, {**task(), "scene_id": scene_id}, None, queue)
    assert store.naming_scene(scene_id) == [plan.id]


def test_more_than_a_batch_is_deleted(database: Database, queue: JobQueue) -> None:
    first = make(database, queue, age_days=5, ended_days=5)
    jobs = workflow_table("sqlite")
    with database.engine.begin() as transaction:
        row = dict(transaction.execute(sa.select(PLANS).where(PLANS.c.id == first)).mappings().one())
        transaction.execute(sa.insert(PLANS), [{**row, "id": f"{n:032x}"} for n in range(BATCH + 5)])
        assert transaction.scalar(sa.select(sa.func.count()).select_from(jobs)) == 1
    assert (
        delete_old(PlanStore(database), SceneStore(database), studies_of(database, queue), queue, days=1) == BATCH + 6
    )


def test_entries_of_the_audit_log_are_deleted_when_they_are_old_enough_and_no_others(database: Database) -> None:
    for age_days in (12, 11, 9, 0):
        entry = {"at_us": now_us() - age_days * US_PER_DAY, "action": "POST", "target": f"{age_days}", "status": 202}
        database.write(sa.insert(AUDIT).values(entry))
    assert [delete_old_audit(database, days=10) for _ in range(2)] == [2, 0]
    assert database.column(sa.select(AUDIT.c.target).order_by(AUDIT.c.number)) == ["9", "0"]
