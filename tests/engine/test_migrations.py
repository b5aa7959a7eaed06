"""The database's version: what older software left is brought up to date, what newer software left is refused."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
import sqlalchemy as sa
from alembic.autogenerate import compare_metadata
from alembic.migration import MigrationContext

from tests.support.accepted import accept
from tests.support.old_tables import back_to_the_first_version
from tests.support.postgres import needs_postgres, running_postgres
from tests.support.samples import sample
from tests.support.service import ROOT, task
from workers.settings import WorkerSettings
from workers.stores.database import open_database
from workers.stores.job_queue import JobQueue
from workers.stores.migrations import LATEST, REVISION_TABLE, VERSION_TABLE, DatabaseTooNew, migrate
from workers.stores.plan_store import PlanStore
from workers.stores.tables import METADATA, PLANS

AT_ONCE = sample(quick=2, whole=3)
START = """
import sys
from pathlib import Path
from workers.settings import WorkerSettings
from workers.stores.database import open_database
open_database(WorkerSettings(data_dir=Path(sys.argv[1]), database_url=sys.argv[2] or None)).close()
"""


@pytest.fixture(params=["sqlite", pytest.param("postgres", marks=needs_postgres)])
def settings(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[WorkerSettings]:
    """Of a place where there is no database yet."""
    if request.param == "sqlite":
        yield WorkerSettings(data_dir=tmp_path)
        return
    with running_postgres() as server:
        yield WorkerSettings(data_dir=tmp_path, database_url=server.url)


@pytest.fixture
def engine(settings: WorkerSettings) -> Iterator[sa.Engine]:
    database = open_database(settings)
    with database.engine.begin() as transaction:
        for name in sa.inspect(transaction).get_table_names():
            if name.startswith("liftwright_"):
                transaction.exec_driver_sql(f"DROP TABLE {name}")
    yield database.engine
    database.close()


def shape(engine: sa.Engine) -> dict[str, tuple[set[str], set[str]]]:
    """Columns and indices of every table of ours."""
    seen = sa.inspect(engine)
    return {
        name: (
            {column["name"] for column in seen.get_columns(name)},
            {str(index["name"]) for index in seen.get_indexes(name)},
        )
        for name in seen.get_table_names()
        if name.startswith("liftwright_")
    }


def told(engine: sa.Engine) -> tuple[int, str]:
    """The version as version 0.1.0 reads it, and as Alembic does."""
    with engine.connect() as connection:
        newest = connection.scalar(sa.select(sa.func.max(VERSION_TABLE.c.version)))
        revision = connection.exec_driver_sql(f"SELECT version_num FROM {REVISION_TABLE}").scalar_one()
    return newest or 0, revision


def test_a_database_without_a_version_gets_what_a_new_one_has_and_keeps_its_plans(settings: WorkerSettings) -> None:
    database = open_database(settings)
    new, queue = shape(database.engine), JobQueue(database)
    plan = accept(PlanStore(database), task(), None, queue)
    back_to_the_first_version(database.engine)
    queue.close()
    database.close()
    again = open_database(settings)
    assert shape(again.engine) == new
    assert PlanStore(again).get(plan.id) == plan
    assert told(again.engine) == (LATEST, f"{LATEST:04}")
    again.close()


def test_the_history_leads_to_the_tables_that_are_used(engine: sa.Engine) -> None:
    """By Alembic's own comparison of the database with the tables, types included."""
    migrate(engine)
    options = {"include_name": lambda name, kind, _: kind != "table" or name in METADATA.tables}
    with engine.connect() as connection:
        assert compare_metadata(MigrationContext.configure(connection, opts=options), METADATA) == []


def test_every_version_that_was_told_as_a_number_is_brought_up_to_date(engine: sa.Engine) -> None:
    migrate(engine)
    new = shape(engine)
    for version in range(1, LATEST + 1):
        with engine.begin() as transaction:
            for name in new:
                transaction.exec_driver_sql(f"DROP TABLE {name}")
        migrate(engine, version)
        row = {"id": "a", "created_us": 1, "kind": "plate_lift", "fingerprint": "", "task": "{}"}
        with engine.begin() as transaction:
            transaction.exec_driver_sql(f"DROP TABLE {REVISION_TABLE}")
            transaction.execute(sa.insert(PLANS).values({**row, "attempts": 0, "crashes": 0, "fraction": 0.5}))
        migrate(engine)
        assert shape(engine) == new, version
        assert told(engine) == (LATEST, f"{LATEST:04}")
        with engine.connect() as connection:
            assert connection.execute(sa.select(PLANS.c.id, PLANS.c.fraction, PLANS.c.owner)).all() == [
                ("a", 0.5, None)
            ]


def test_migrating_twice_changes_nothing(engine: sa.Engine) -> None:
    migrate(engine)
    before = shape(engine)
    migrate(engine)
    assert shape(engine) == before
    assert set(before) == {*METADATA.tables, VERSION_TABLE.name, REVISION_TABLE}


@pytest.mark.slow
def test_services_that_start_together_on_a_new_database_take_turns(settings: WorkerSettings, tmp_path: Path) -> None:
    command = [sys.executable, "-c", START, str(tmp_path), settings.database_url or ""]
    starting = [subprocess.Popen(command, cwd=ROOT, stderr=subprocess.PIPE, text=True) for _ in range(AT_ONCE)]
    ended = [(each.communicate()[1], each.returncode) for each in starting]
    assert [code for _, code in ended] == [0] * AT_ONCE, ended
    database = open_database(settings)
    assert told(database.engine) == (LATEST, f"{LATEST:04}")
    database.close()


@pytest.mark.parametrize("told_by_alembic", [False, True])
def test_a_database_of_newer_software_is_refused_and_left_alone(tmp_path: Path, told_by_alembic: bool) -> None:
    settings = WorkerSettings(data_dir=tmp_path)
    database = open_database(settings)
    with database.engine.begin() as transaction:
        if told_by_alembic:
            transaction.exec_driver_sql(f"UPDATE {REVISION_TABLE} SET version_num = '{LATEST + 1:04}'")
        else:
            transaction.execute(sa.insert(VERSION_TABLE).values(version=LATEST + 1))
    before = shape(database.engine)
    database.close()
    with pytest.raises(DatabaseTooNew, match=f"of version {LATEST + 1}, this software knows {LATEST}"):
        open_database(settings)
    engine = sa.create_engine(database.engine.url)
    assert shape(engine) == before
    engine.dispose()
