"""The history of our tables, as Alembic runs it: a file in `versions` for each step. The job engine migrates its own.

A step changes tables only so that the version before still runs on them: workers are upgraded one by one.
"""

from __future__ import annotations

import threading
from pathlib import Path

import sqlalchemy as sa
from alembic import command
from alembic.config import Config
from alembic.migration import MigrationContext

from planners.errors import LiftwrightError

FOLDER = Path(__file__).parent
LATEST = max(int(path.name.partition("_")[0]) for path in (FOLDER / "versions").glob("[0-9]*.py"))
REVISION_TABLE = "liftwright_revision"
"""Where Alembic keeps the version that the tables have, as four digits."""
VERSION_TABLE = sa.Table(
    "liftwright_schema", sa.MetaData(), sa.Column("version", sa.Integer, primary_key=True, autoincrement=False)
)
"""Where version 0.1.0 keeps it, as a number. It is still told there, so that older software refuses what is newer."""
LOCK_KEY = 0x11F7_0001
"""Of the advisory lock that a migration holds: services that start together take turns."""

_alone = threading.Lock()
"""Alembic has one migration at a time in a process."""


class DatabaseTooNew(LiftwrightError):
    """A newer version of the software has used the database."""

    def __init__(self, found: int) -> None:
        super().__init__(
            f"the database is of version {found}, this software knows {LATEST}: start the newer version again, or "
            "restore the backup that was made before the upgrade"
        )


def migrate(engine: sa.Engine, version: int = LATEST) -> None:
    """Bring all tables to a version, or make them. One transaction: it happens wholly or not at all.

    Raises:
        DatabaseTooNew: They are ahead of this software.
    """
    with _alone, engine.begin() as transaction:
        if engine.dialect.name == "postgresql":
            transaction.execute(sa.select(sa.func.pg_advisory_xact_lock(LOCK_KEY)))
        else:
            # SQLite's driver begins a transaction by itself only where rows are written.
            transaction.exec_driver_sql("BEGIN IMMEDIATE")
        VERSION_TABLE.create(transaction, checkfirst=True)
        told = transaction.scalar(sa.select(sa.func.max(VERSION_TABLE.c.version))) or 0
        revision = MigrationContext.configure(
            transaction, opts={"version_table": REVISION_TABLE}
        ).get_current_revision()
        found = max(told, int(revision or 0))
        if found > LATEST:
            raise DatabaseTooNew(found)
        config = Config(attributes={"connection": transaction})
        config.set_main_option("script_location", str(FOLDER).replace("%", "%%"))
        if revision is None and told:
            command.stamp(config, f"{told:04}")
        # Tables of which no version is told are those of the first one, or there are none.
        if found < version:
            command.upgrade(config, f"{version:04}")
            transaction.execute(sa.insert(VERSION_TABLE).values(version=version))
