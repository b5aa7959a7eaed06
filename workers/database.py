"""Opens the database that the engine and our tables share: SQLite in WAL mode, or PostgreSQL."""

from __future__ import annotations

import sqlite3
from dataclasses import dataclass

import sqlalchemy as sa
from dbos import run_dbos_database_migrations
from sqlalchemy import event

from workers.settings import WorkerSettings
from workers.tables import METADATA

SQLITE_FILE = "liftwright.sqlite"
BUSY_MS = 30_000
"""How long a writer waits for another one [ms]; the engine's own connections wait as long."""


@dataclass(frozen=True, eq=False)
class Database:
    """An open database with all tables in place."""

    engine: sa.Engine
    engine_url: str
    """The same database as the job engine wants it named."""

    def close(self) -> None:
        """Give all connections back."""
        self.engine.dispose()


def open_database(settings: WorkerSettings) -> Database:
    """Open the database, making what is missing."""
    settings.data_dir.mkdir(parents=True, exist_ok=True)
    if settings.database_url is None:
        path = settings.data_dir.resolve() / SQLITE_FILE
        url = f"sqlite:///{path}"
        _switch_to_wal(str(path))
        engine = sa.create_engine(url)
        event.listen(engine, "connect", _set_up_sqlite)
    else:
        url = settings.database_url
        engine = sa.create_engine(sa.make_url(url).set(drivername="postgresql+psycopg"), pool_pre_ping=True)
    run_dbos_database_migrations(url)
    METADATA.create_all(engine)
    return Database(engine, url)


def _switch_to_wal(path: str) -> None:
    """Once, before anybody else has the file open: the mode stays with the file."""
    connection = sqlite3.connect(path)
    try:
        connection.execute("PRAGMA journal_mode=WAL")
    finally:
        connection.close()


def _set_up_sqlite(connection: sqlite3.Connection, _record: object) -> None:
    # Writers queue up at their first statement instead of failing when a read becomes a write.
    connection.isolation_level = "IMMEDIATE"
    connection.execute(f"PRAGMA busy_timeout={BUSY_MS}")
    connection.execute("PRAGMA synchronous=NORMAL")
