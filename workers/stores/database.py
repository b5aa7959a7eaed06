"""Opens the database that the engine and our tables share: SQLite in WAL mode, or PostgreSQL."""

from __future__ import annotations

import sqlite3
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import sqlalchemy as sa
import structlog
from dbos import run_dbos_database_migrations
from sqlalchemy import event

from workers.settings import WorkerSettings
from workers.stores.database_loss import DATABASE_GONE, said_by, tell_refusal_as_loss
from workers.stores.migrations import migrate
from workers.stores.tables import TOTALS

SQLITE_FILE = "liftwright.sqlite"
BUSY_MS = 30_000
"""How long a writer waits for another one [ms]; the engine's own connections wait as long."""
START_SECONDS = 60.0
"""How long a start waits for the server [s]."""
SERVER_PATIENCE = {
    "connect_timeout": "5",
    "keepalives_idle": "5",
    "keepalives_interval": "5",
    "keepalives_count": "2",
    "tcp_user_timeout": "15000",
    "options": "-c idle_in_transaction_session_timeout=10000",
}
"""When a connection counts as lost: libpq's own limits are hours.

A process that is frozen within a transaction still answers for its connection, and holds the rows that it has locked:
the server ends that session, so that others can take its jobs over.
"""
POOL_SIZE = 20
POOL_SECONDS = 5.0
"""How long a request waits for a connection to be free [s]."""

log = structlog.get_logger(__name__)


@dataclass(frozen=True, eq=False)
class Database:
    """An open database with all tables in place."""

    engine: sa.Engine
    engine_url: str
    """The same database as the job engine wants it named."""

    def rows(self, query: sa.Executable) -> Sequence[sa.Row[Any]]:
        """Return what a query finds."""
        with self.engine.connect() as connection:
            return connection.execute(query).all()

    def mappings(self, query: sa.Executable) -> Sequence[sa.RowMapping]:
        """Return what a query finds, each row as a mapping from the names of columns."""
        with self.engine.connect() as connection:
            return connection.execute(query).mappings().all()

    def column(self, query: sa.Executable) -> list[Any]:
        """Return the first column of what a query finds."""
        with self.engine.connect() as connection:
            return list(connection.scalars(query))

    def scalar(self, query: sa.Executable) -> Any:
        """Return the one value that a query finds; None if it finds nothing."""
        with self.engine.connect() as connection:
            return connection.scalar(query)

    def write(self, statement: sa.Executable) -> int:
        """Change rows, in a transaction of its own, and return how many."""
        with self.engine.begin() as transaction:
            return transaction.execute(statement).rowcount

    def require_writable(self) -> None:
        """Raise what `DATABASE_GONE` lists if it cannot be reached, or takes no writes."""
        # A server that refuses to lock refuses to write; SQLite, where nobody else may be the primary, is only read.
        with self.engine.connect() as connection:
            connection.execute(sa.select(TOTALS.c.count).where(sa.false()).with_for_update())

    def close(self) -> None:
        """Give all connections back."""
        self.engine.dispose()


def open_database(settings: WorkerSettings) -> Database:
    """Open the database and bring its tables to this version; wait for a server that has not started yet.

    Raises:
        DatabaseTooNew: A newer version of this software has used it.
    """
    tell_refusal_as_loss()
    settings.data_dir.mkdir(parents=True, exist_ok=True)
    if settings.database_url is None:
        path = settings.data_dir.resolve() / SQLITE_FILE
        url = f"sqlite:///{path}"
        _switch_to_wal(str(path))
        engine = sa.create_engine(url)
        event.listen(engine, "connect", _set_up_sqlite)
    else:
        url = _with_timeouts(settings.database_url)
        engine = sa.create_engine(
            sa.make_url(url).set(drivername="postgresql+psycopg"),
            pool_pre_ping=True,
            pool_size=POOL_SIZE,
            pool_timeout=POOL_SECONDS,
        )
        _wait_for_server(engine)
    run_dbos_database_migrations(url)
    migrate(engine)
    return Database(engine, url)


def _with_timeouts(url: str) -> str:
    """Have a server that does not answer be an error soon, unless the operator has said otherwise."""
    given = sa.make_url(url)
    return given.update_query_dict({**SERVER_PATIENCE, **given.query}).render_as_string(hide_password=False)


def _wait_for_server(engine: sa.Engine) -> None:
    deadline = time.monotonic() + START_SECONDS
    while True:
        try:
            with engine.connect():
                return
        except DATABASE_GONE as error:
            if time.monotonic() > deadline:
                raise
            log.warning("waiting for the database", error=said_by(error))
        time.sleep(1.0)


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
