"""Text of every length and with every character is kept, or looked for and not found, on either database."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

import pytest
import sqlalchemy as sa
from sqlalchemy.exc import DataError

from app.access.audit_log import AuditLog
from app.access.caller import Caller, Scope
from planners.progress import Report
from tests.support.accepted import accept
from tests.support.places import on_both_databases
from tests.support.service import task
from workers.engine.job_runner import JobRunner
from workers.settings import WorkerSettings
from workers.stores.cell_store import CellStore
from workers.stores.database import Database, open_database
from workers.stores.job_queue import JobQueue
from workers.stores.jobs import workflow_table
from workers.stores.mesh_store import MeshStore
from workers.stores.plan_store import PackedDocument, PlanEvent, PlanStore
from workers.stores.scene_store import SceneStore
from workers.stores.tables import METADATA, StoredText
from workers.stores.task_parts import TaskParts
from workers.stores.totals import STAGE
from workers.stores.webhook_store import WebhookStore

LONGEST_NAME = "n" * 64


@on_both_databases
def test_progress_of_an_object_with_the_longest_name_is_kept(database: Database, queue: JobQueue) -> None:
    store = PlanStore(database)
    plan_id = accept(store, task(), None, queue).id
    stage = f"second regrasp {LONGEST_NAME}"
    store.add_event(plan_id, PlanEvent(attempt=0, stage=stage, fraction=0.5))
    record = store.get(plan_id)
    assert record is not None
    assert (record.stage, record.fraction) == (stage, 0.5)


@on_both_databases
def test_stages_are_counted(database: Database, queue: JobQueue) -> None:
    store = PlanStore(database)
    stages = (("second regrasp", 0.25), ("scene", 0.125), ("second regrasp", 0.5))
    document = PackedDocument("solved", "0" * 64, b"", stages)
    assert store.save_document(accept(store, task(), None, queue).id, 0, document)
    counted = {total.label: (total.count, total.seconds) for total in store.totals() if total.name == STAGE}
    assert counted == {"scene": (1, 0.125), "second regrasp": (2, 0.75)}


@on_both_databases
def test_whatever_callers_and_proxies_send_is_kept_in_the_audit_log(database: Database) -> None:
    audit = AuditLog(database)
    audit.add(Caller(None, None, Scope.ADMIN), "a" * 200, "X" * 200, "/v1/plans/\0" + "x" * 400, 404)
    (entry,) = audit.newest(1, None)
    assert (entry.address, entry.action) == ("a" * 64, "X" * 64)
    assert entry.target.startswith("/v1/plans/\N{REPLACEMENT CHARACTER}xxx")


@on_both_databases
@pytest.mark.parametrize("name", ["\0", "a\0b", "x" * 200, "\N{ROBOT FACE}"])
def test_an_id_that_cannot_exist_is_not_found(database: Database, name: str) -> None:
    plans = PlanStore(database)
    assert plans.get(name) is None
    assert plans.task(name) is None
    assert plans.by_key(name) is None
    assert WebhookStore(database).get(name) is None
    assert SceneStore(database).get(name) is None
    assert MeshStore(database).get(name) is None


def test_every_column_of_text_takes_what_any_other_takes() -> None:
    """Columns without a limit have JSON in them, which writes every odd character out."""
    for table in METADATA.tables.values():
        for column in table.columns:
            limited = isinstance(column.type, sa.String) and not isinstance(column.type, sa.Text)
            assert isinstance(column.type, StoredText) or not limited, column


class ForgetfulStore(PlanStore):
    """A store that takes no progress."""

    def add_event(self, plan_id: str, event: PlanEvent) -> None:
        raise DataError("INSERT …", {}, ValueError(f"too long: {event.stage} of {plan_id}"))


class QuickPool:
    """Solvers that report once and are done."""

    async def solve(self, _request: Any, show: Any, _seconds: float, _certified: Any) -> PackedDocument:
        await show(Report("scene", 1, 1))
        return PackedDocument("solved", "0" * 64, b"document")


def test_a_job_goes_on_whatever_the_database_says_to_its_progress(tmp_path: Path) -> None:
    settings = WorkerSettings(data_dir=tmp_path)
    database = open_database(settings)
    queue, store = JobQueue(database), ForgetfulStore(database)
    plan_id = accept(store, task(), None, queue).id
    with database.engine.begin() as transaction:
        begun = sa.update(workflow_table("sqlite")).values(status="PENDING", executor_id=settings.executor_name)
        transaction.execute(begun)
    parts = TaskParts(MeshStore(database), CellStore(database, tmp_path))
    runner = JobRunner(settings, queue, store, parts, QuickPool())  # pyright: ignore[reportArgumentType]
    assert asyncio.run(runner.run(plan_id)) == "solved"
    assert store.outcome(plan_id) == "solved"
    queue.close()
    database.close()
