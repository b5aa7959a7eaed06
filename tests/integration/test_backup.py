"""What docs/operations.md says of backups: a copy made while the service runs holds plans, documents and jobs."""

from __future__ import annotations

import shutil
import sqlite3
from contextlib import closing
from pathlib import Path

import pytest

from tests.support.accepted import accept
from tests.support.postgres import PostgresServer, needs_postgres, running_postgres
from tests.support.service import task
from workers.settings import WorkerSettings
from workers.stores.database import SQLITE_FILE, Database, open_database
from workers.stores.job_queue import JobQueue
from workers.stores.jobs import JobState
from workers.stores.plan_store import PackedDocument, PlanRecord, PlanStore


def fill(database: Database) -> tuple[PlanRecord, PlanRecord]:
    """Store a plan with a document and one that waits."""
    queue, store = JobQueue(database), PlanStore(database)
    done, waiting = (accept(store, task(), key, queue).id for key in ("a", "b"))
    assert store.save_document(done, 0, PackedDocument("solved", "0" * 64, b"the document", (("search", 1.0),)))
    queue.close()
    records = store.get(done), store.get(waiting)
    assert records[0] is not None
    assert records[1] is not None
    return records


def assert_holds(database: Database, records: tuple[PlanRecord, PlanRecord]) -> None:
    queue, store = JobQueue(database), PlanStore(database)
    for record in records:
        assert store.get(record.id) == record
        assert store.task(record.id) == task()
        assert queue.jobs([record.id])[record.id].state is JobState.QUEUED
    document = store.document(records[0].id)
    assert document is not None
    assert document.gzip == b"the document"
    # A repeated request finds what it made before the backup.
    assert accept(store, task(), "a", queue).id == records[0].id
    queue.close()


def test_a_copy_of_sqlite_made_while_it_is_open_is_whole(tmp_path: Path) -> None:
    running = open_database(WorkerSettings(data_dir=tmp_path / "running"))
    records = fill(running)
    copy = tmp_path / "copy.sqlite"
    with (
        closing(sqlite3.connect(tmp_path / "running" / SQLITE_FILE)) as source,
        closing(sqlite3.connect(copy)) as target,
    ):
        source.backup(target)
    running.close()
    (tmp_path / "restored").mkdir()
    shutil.copy(copy, tmp_path / "restored" / SQLITE_FILE)
    restored = open_database(WorkerSettings(data_dir=tmp_path / "restored"))
    assert_holds(restored, records)
    restored.close()


@needs_postgres
@pytest.mark.slow
def test_a_dump_of_postgresql_made_while_it_is_in_use_is_whole(tmp_path: Path) -> None:
    with running_postgres() as server:
        running = open_database(WorkerSettings(data_dir=tmp_path, database_url=server.url))
        records = fill(running)
        restored_url = dump_and_restore(server)
        running.close()
        restored = open_database(WorkerSettings(data_dir=tmp_path, database_url=restored_url))
        assert_holds(restored, records)
        restored.close()


def dump_and_restore(server: PostgresServer) -> str:
    """Bring one database into another, as the documentation says, and return the other's address."""
    dump, empty = server.folder / "dump", f"{server.url.removesuffix('/liftwright')}/restored"
    server.run("pg_dump", "--format=custom", f"--file={dump}", f"--dbname={server.url}")
    server.run("createdb", f"--maintenance-db={server.url}", "restored")
    server.run("pg_restore", f"--dbname={empty}", "--exit-on-error", dump)
    return empty
