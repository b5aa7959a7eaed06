"""Versions of our tables, and the steps from each to the next. The job engine keeps and migrates its own."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType

import sqlalchemy as sa

from planners.errors import LiftwrightError
from workers.stores.tables import DOCUMENTS, METADATA, PLANS, SCENES

VERSION_TABLE = sa.Table(
    "liftwright_schema", sa.MetaData(), sa.Column("version", sa.Integer, primary_key=True, autoincrement=False)
)
LOCK_KEY = 0x11F7_0001
"""Of the advisory lock that a migration holds: services that start together take turns."""


class DatabaseTooNew(LiftwrightError):
    """A newer version of the software has used the database."""

    def __init__(self, found: int) -> None:
        super().__init__(
            f"the database is of version {found}, this software knows {LATEST}: start the newer version again, or "
            "restore the backup that was made before the upgrade"
        )


def _index_what_is_searched(connection: sa.Connection) -> None:
    """Plans are found by the name that the caller gave them, and documents counted without reading them."""
    for table, name in ((PLANS, "liftwright_plans_external_id"), (DOCUMENTS, "liftwright_documents_outcome")):
        _create_index(connection, table, name)


def _give_plans_owners(connection: sa.Connection) -> None:
    """Plans belong to whoever holds the key they were posted with; those of before belong to nobody."""
    _add_columns(connection, PLANS, "owner")
    _create_index(connection, PLANS, "liftwright_plans_newest_of_owner")


def _keep_scenes(connection: sa.Connection) -> None:
    """Perceived scenes are kept, and tasks name them: software that knows no scenes cannot read such tasks."""
    SCENES.create(connection, checkfirst=True)


def _let_scenes_go(connection: sa.Connection) -> None:
    """Scenes belong to whoever posted them, are listed and deleted, and stay while a plan names them."""
    _add_columns(connection, SCENES, "owner", "posted_us", "points")
    _add_columns(connection, PLANS, "scene_id")
    _create_index(connection, PLANS, "liftwright_plans_of_scene")
    for name in ("liftwright_scenes_newest", "liftwright_scenes_newest_of_owner"):
        _create_index(connection, SCENES, name)


def _index_kinds(connection: sa.Connection) -> None:
    """The plans of one kind are listed without a look at the others."""
    _create_index(connection, PLANS, "liftwright_plans_newest_of_kind")


def _keep_orders(connection: sa.Connection) -> None:
    """Plans have what an MES says about their jobs; those of before have nothing of it."""
    _add_columns(connection, PLANS, "work_master", "priority", "start_us", "end_us")
    _create_index(connection, PLANS, "liftwright_plans_work_master")


def _name_stages_in_full(connection: sa.Connection) -> None:
    """A stage has the name of an object in it, and with that any length; SQLite never minded."""
    if connection.dialect.name == "postgresql":
        connection.exec_driver_sql(f"ALTER TABLE {PLANS.name} ALTER COLUMN {PLANS.c.stage.name} TYPE TEXT")


def _keep_what_was_sent(connection: sa.Connection) -> None:
    """A repeat is known by what was sent; of plans of before only what it was taken for is known."""
    _add_columns(connection, PLANS, "sent_fingerprint")


def _add_columns(connection: sa.Connection, table: sa.Table, *names: str) -> None:
    there = {column["name"] for column in sa.inspect(connection).get_columns(table.name)}
    for name in names:
        if name not in there:
            column = sa.schema.CreateColumn(table.c[name]).compile(dialect=connection.dialect)
            connection.exec_driver_sql(f"ALTER TABLE {table.name} ADD COLUMN {column}")


def _create_index(connection: sa.Connection, table: sa.Table, name: str) -> None:
    next(index for index in table.indexes if index.name == name).create(connection, checkfirst=True)


STEPS: Mapping[int, Callable[[sa.Connection], None]] = MappingProxyType(
    {
        2: _index_what_is_searched,
        3: _give_plans_owners,
        4: _keep_scenes,
        5: _let_scenes_go,
        6: _index_kinds,
        7: _keep_orders,
        8: _name_stages_in_full,
        9: _keep_what_was_sent,
    }
)
"""Each leads from the version before to its own. Tables that are new need none: they are made where they are missing.
A step changes tables only so that the version before still runs on them: workers are upgraded one by one."""
LATEST = max(STEPS)


def migrate(engine: sa.Engine) -> None:
    """Bring all tables to the latest version, or make them. One transaction: it happens wholly or not at all.

    Raises:
        DatabaseTooNew: They are ahead of this software.
    """
    with engine.begin() as transaction:
        if engine.dialect.name == "postgresql":
            transaction.execute(sa.select(sa.func.pg_advisory_xact_lock(LOCK_KEY)))
        else:
            # SQLite's driver begins a transaction by itself only where rows are written.
            transaction.exec_driver_sql("BEGIN IMMEDIATE")
        METADATA.create_all(transaction)
        VERSION_TABLE.create(transaction, checkfirst=True)
        # Tables without a version are those of the first one.
        found = transaction.scalar(sa.select(sa.func.max(VERSION_TABLE.c.version))) or 1
        if found > LATEST:
            raise DatabaseTooNew(found)
        for version in range(found + 1, LATEST + 1):
            STEPS[version](transaction)
            transaction.execute(sa.insert(VERSION_TABLE).values(version=version))
