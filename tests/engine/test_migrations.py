"""The database's version: what older software left is brought up to date, what newer software left is refused."""

from __future__ import annotations

from pathlib import Path

import pytest
import sqlalchemy as sa
from support.old_tables import back_to_the_first_version
from support.service import task

from workers.settings import WorkerSettings
from workers.stores.database import open_database
from workers.stores.job_queue import JobQueue
from workers.stores.migrations import LATEST, VERSION_TABLE, DatabaseTooNew, migrate
from workers.stores.plan_store import PlanStore
from workers.stores.tables import METADATA


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


def test_a_database_without_a_version_gets_what_a_new_one_has_and_keeps_its_plans(tmp_path: Path) -> None:
    settings = WorkerSettings(data_dir=tmp_path)
    database = open_database(settings)
    new, queue = shape(database.engine), JobQueue(database)
    plan = PlanStore(database).accept(task(), None, queue)
    back_to_the_first_version(database.engine)
    queue.close()
    database.close()
    again = open_database(settings)
    assert shape(again.engine) == new
    assert PlanStore(again).get(plan.id) == plan
    again.close()


def test_migrating_twice_changes_nothing(tmp_path: Path) -> None:
    database = open_database(WorkerSettings(data_dir=tmp_path))
    before = shape(database.engine)
    migrate(database.engine)
    assert shape(database.engine) == before
    assert set(before) == {*METADATA.tables, VERSION_TABLE.name}
    database.close()


def test_a_database_of_newer_software_is_refused_and_left_alone(tmp_path: Path) -> None:
    settings = WorkerSettings(data_dir=tmp_path)
    database = open_database(settings)
    with database.engine.begin() as transaction:
        transaction.execute(sa.insert(VERSION_TABLE).values(version=LATEST + 1))
    database.close()
    with pytest.raises(DatabaseTooNew, match=f"of version {LATEST + 1}, this software knows {LATEST}"):
        open_database(settings)
