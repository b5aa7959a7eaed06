"""Opens the database that the engine and our tables share: SQLite in WAL mode, or PostgreSQL."""

from __future__ import annotations

import math
import re
import shutil
import sqlite3
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, TypeVar
from urllib.parse import quote, unquote

import sqlalchemy as sa
import structlog
from dbos import DBOS
from sqlalchemy import event, exc
from sqlalchemy.engine.interfaces import DBAPIConnection
from sqlalchemy.pool import ConnectionPoolEntry

from planners.errors import LiftwrightError
from workers.settings import WorkerSettings
from workers.stores.database_loss import DATABASE_GONE, said_by, tell_refusal_as_loss
from workers.stores.migrations import migrate
from workers.stores.tables import TOTALS

SQLITE_FILE = "liftwright.sqlite"
BUSY_MS = 30_000
"""How long a writer waits for another one [ms]; the engine's own connections wait as long."""
START_SECONDS = 60.0
"""How long each step of a start waits for the server [s]."""
START_PAUSE_SECONDS = 1.0
SERVER_PATIENCE = {
    "connect_timeout": "5",
    "keepalives_idle": "5",
    "keepalives_interval": "5",
    "keepalives_count": "2",
    "tcp_user_timeout": "15000",
    # Else a database that knows no encoding gives bytes for texts, before it could be refused for that.
    "client_encoding": "utf8",
}
"""When a connection counts as lost: libpq's own limits are hours."""
SERVER_OPTIONS = "-c idle_in_transaction_session_timeout=10000"
"""What the server is told at each connection.

A process that is frozen within a transaction still answers for its connection, and holds the rows that it has locked:
the server ends that session, so that others can take its jobs over.
"""
POOL_SECONDS = 5.0
"""How long a request waits for a connection of ours to be free, or for one that the server can spare [s]."""
SPARE_LOOK_SECONDS = 0.1
RESTED_SECONDS = 1.0
"""A connection that was used within this time is used again without being asked first whether it still leads to the
server: that would cost every request a round trip. What it loses then is told as any loss is [s]."""
RESTS_SINCE = "rests since"
NO_CONNECTION_LEFT = ("too many clients", "remaining connection slots", "too many connections")
"""What a server says that has no connection to spare: it says so before it could name an SQLSTATE."""
SQLITE_ROOM_BYTES = 16 * 2**20
"""With less on its disk, SQLite may not be able to keep the next documents [bytes]."""
PROBE = "probe"
"""Name of the row that is written to learn whether it can be."""
ENCODING = "UTF8"

T = TypeVar("T")
log = structlog.get_logger(__name__)


class DatabaseUnusable(LiftwrightError):
    """There is no database to work with, and waiting would not help."""


@dataclass(frozen=True, eq=False)
class Database:
    """An open database with all tables in place."""

    engine: sa.Engine
    engine_url: str
    """The same database as the job engine wants it named."""
    embedded_in: Path | None = None
    """The folder of its file; None: a server has it."""

    @property
    def shared_engine(self) -> sa.Engine | None:
        """What the job engine uses as well, so that a process has one pool of connections; None: it has one of its own.

        On SQLite connections cost nothing, and the job engine begins its transactions in another way.
        """
        return self.engine if self.embedded_in is None else None

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

    def confirm(self) -> None:
        """Return once nothing that was read before can be lost any more; whoever answers by what was read calls it.

        A server whose commits wait for a standby shows after a crash what it had committed and the standby has not got
        yet. Whatever is committed after that comes behind it in the log, and waits for both.
        """
        if self.embedded_in is None:
            with self.engine.begin() as transaction:
                transaction.execute(sa.text("SELECT pg_logical_emit_message(true, 'liftwright', '')"))

    def require_writable(self) -> None:
        """Raise what `DATABASE_GONE` lists if it cannot be reached, or takes no writes."""
        if self.embedded_in is not None:
            if shutil.disk_usage(self.embedded_in).free < SQLITE_ROOM_BYTES:
                raise _failure(f"the disk of {self.embedded_in} is full")
            self._write_probe()
            return
        # A server that refuses to lock refuses to write.
        with self.engine.connect() as connection:
            connection.execute(sa.select(TOTALS.c.count).where(sa.false()).with_for_update())

    def _write_probe(self) -> None:
        """Write a row that means nothing: what a disk takes is only known when it has taken it."""
        row = {"name": PROBE, "label": "", "count": 0, "seconds": time.time()}
        with self.engine.begin() as transaction:
            written = transaction.execute(sa.update(TOTALS).where(TOTALS.c.name == PROBE).values(row)).rowcount
            if not written:
                transaction.execute(sa.insert(TOTALS).values(row))

    def at_start(self, call: Callable[[], T]) -> T:
        """Return what a call returns; while a server is away it is made again, for as long as a start waits.

        It may happen twice: if the connection breaks while the answer is on its way, nobody knows whether it was done.

        Raises:
            DatabaseUnusable: The server was away for all that time, or says that it is asked for what it has not.
        """
        deadline = time.monotonic() + START_SECONDS
        while True:
            try:
                return call()
            except DATABASE_GONE as error:
                if self.embedded_in is not None:
                    raise
                if time.monotonic() > deadline:
                    raise self._unusable(error) from error
                log.warning("waiting for the database", error=said_by(error))
            except exc.DBAPIError as error:
                raise self._unusable(error) from error
            time.sleep(START_PAUSE_SECONDS)

    def close(self) -> None:
        """Give all connections back."""
        self.engine.dispose()

    def _unusable(self, error: exc.SQLAlchemyError) -> DatabaseUnusable:
        return DatabaseUnusable(f"{_shown(self.engine)} cannot be used: {_first_line(error)}")


def open_database(settings: WorkerSettings) -> Database:
    """Open the database and bring its tables to this version; wait for a server that has not started yet.

    Raises:
        DatabaseTooNew: A newer version of this software has used it.
        DatabaseUnusable: There is none, it is none of ours, or nothing can be written to it.
    """
    tell_refusal_as_loss()
    if settings.database_url is None:
        return _open_file(settings.data_dir)
    database = server_database(settings)
    with ExitStack() as opened:
        opened.callback(database.close)
        database.at_start(partial(_prepare, database))
        opened.pop_all()
    return database


def server_database(settings: WorkerSettings, seconds: int | None = None) -> Database:
    """Return a database on a server, of which nothing is asked yet.

    Args:
        settings: with a `database_url`.
        seconds: how long a connection may take; None: as long as to be sure that nobody answers [s].

    Raises:
        DatabaseUnusable: The address is none.
    """
    url = _with_timeouts(
        _read_url(settings.database_url or ""), {} if seconds is None else {"connect_timeout": f"{seconds}"}
    )
    engine = sa.create_engine(
        url.set(drivername="postgresql+psycopg"),
        pool_size=settings.database_connections,
        max_overflow=0,
        pool_timeout=POOL_SECONDS,
    )
    event.listen(engine, "do_connect", _connect_to_spare)
    event.listen(engine, "checkin", _note_rest)
    event.listen(engine, "checkout", partial(_ask_rested, engine.dialect))
    return Database(engine, url.render_as_string(hide_password=False))


def _open_file(data_dir: Path) -> Database:
    folder = data_dir.resolve()
    path = folder / SQLITE_FILE
    with ExitStack() as opened:
        try:
            folder.mkdir(parents=True, exist_ok=True)
            _switch_to_wal(str(path))
            engine = sa.create_engine(f"sqlite:///{path}")
            opened.callback(engine.dispose)
            event.listen(engine, "connect", _set_up_sqlite)
            same_file = _same_file(path)
            # Before it is opened, too: that would make an empty one.
            event.listen(engine, "do_connect", same_file)
            event.listen(engine, "checkout", same_file)
            DBOS.migrate(f"sqlite:///{path}")
            migrate(engine)
        except OSError as error:
            raise DatabaseUnusable(f"{folder} cannot be written to: {error.strerror}") from error
        except (sqlite3.Error, exc.DBAPIError) as error:
            raise DatabaseUnusable(f"{path} cannot be used: {_first_line(error)}") from error
        opened.pop_all()
        return Database(engine, f"sqlite:///{path}", folder)


def _read_url(text: str) -> sa.URL:
    """Return an address; in its password every character may stand for itself, but %40 is an @.

    Raises:
        DatabaseUnusable: It is none of PostgreSQL.
    """
    scheme, _, rest = text.partition("://")
    place, query = _without_query(rest)
    # The last @ ends the password, though RFC 3986 wants others, and / # : in it, to be written as %40 and the like.
    # What stands in a query ends none: there an @ is as good as any other character.
    who, at, where = place.rpartition("@")
    user, colon, password = who.partition(":")
    try:
        url = sa.make_url(f"{scheme}://{user}{colon}{quote(unquote(password), safe='')}{at}{where}{query}")
    except (exc.ArgumentError, ValueError):
        url = None
    if url is None or url.get_backend_name() not in ("postgresql", "postgres"):
        raise DatabaseUnusable("database_url must be postgresql://USER:PASSWORD@HOST:PORT/DATABASE")
    return url


def _without_query(text: str) -> tuple[str, str]:
    """Return what of an address comes before its query, and the query with its ?.

    A password may have a ? in it: a query begins with one before the name of something that libpq can be told.
    """
    # Who works on SQLite has it not.
    from psycopg.pq import Conninfo

    names = "|".join(re.escape(each.keyword.decode()) for each in Conninfo.get_defaults())
    found = re.search(rf"\?({names})=", text)
    return (text, "") if found is None else (text[: found.start()], text[found.start() :])


def _with_timeouts(url: sa.URL, more: Mapping[str, str]) -> sa.URL:
    """Have a server that does not answer be an error soon, unless the operator has said otherwise."""
    # What is set twice is as it was set last.
    options = f"{SERVER_OPTIONS} {url.query.get('options', '')}".rstrip()
    return url.update_query_dict({**SERVER_PATIENCE, **url.query, "options": options, **more})


def _connect_to_spare(
    dialect: sa.Dialect, _record: object, arguments: list[Any], named: dict[str, Any]
) -> DBAPIConnection:
    """Connect to a server that may have no connection to spare for a moment."""
    deadline = time.monotonic() + POOL_SECONDS
    while True:
        try:
            return dialect.connect(*arguments, **named)
        except Exception as error:
            full = any(words in str(error) for words in NO_CONNECTION_LEFT)
            if not full or time.monotonic() > deadline:
                raise
        time.sleep(SPARE_LOOK_SECONDS)


def _note_rest(_connection: object, record: ConnectionPoolEntry) -> None:
    record.info[RESTS_SINCE] = time.monotonic()


def _ask_rested(dialect: sa.Dialect, connection: DBAPIConnection, record: ConnectionPoolEntry, _used: object) -> None:
    """Ask a connection that has rested whether it still leads to the server; if not, all are made anew."""
    # One that was made just now has never rested.
    if time.monotonic() - record.info.get(RESTS_SINCE, math.inf) < RESTED_SECONDS:
        return
    try:
        dialect.do_ping(connection)
    except dialect.loaded_dbapi.Error as error:
        raise exc.InvalidatePoolError from error


def _prepare(database: Database) -> None:
    """Bring all tables to this version; what was done of it before stays as it is."""
    _require_encoding(database.engine)
    # The engine's command does the same, but ends the process with whatever goes wrong.
    DBOS.migrate(database.engine_url)
    migrate(database.engine)


def _require_encoding(engine: sa.Engine) -> None:
    """Raise `DatabaseUnusable` unless a database has texts as we have them."""
    with engine.connect() as connection:
        encoding = connection.scalar(sa.text("SHOW server_encoding"))
    if encoding != ENCODING:
        raise DatabaseUnusable(
            f"{_shown(engine)} has the encoding {encoding}, and must have {ENCODING}: create it anew with "
            f"CREATE DATABASE {engine.url.database} ENCODING '{ENCODING}' TEMPLATE template0"
        )


def _shown(engine: sa.Engine) -> str:
    """Return where a database is, without the password."""
    url = engine.url
    named = url.query.get("host", ())
    hosts = (named,) if isinstance(named, str) else named
    where = " or ".join(hosts) or f"{url.host or 'this machine'}:{url.port or 5432}"
    return f"the database {url.database} on {where}"


def _first_line(error: Exception) -> str:
    """Return what a database says, without what it was asked."""
    said = said_by(error) if isinstance(error, exc.SQLAlchemyError) else str(error)
    return said.strip().splitlines()[0] if said.strip() else type(error).__name__


def _same_file(path: Path) -> Callable[..., None]:
    """Return what looks, whenever a connection is used, whether it still leads to the file that has the name."""
    opened = path.stat()

    def look(*_: object) -> None:
        try:
            now = path.stat()
        except OSError:
            now = None
        if now is None or (now.st_dev, now.st_ino) != (opened.st_dev, opened.st_ino):
            # What is written goes into a file without a name, and is gone when the last process has closed it.
            raise _failure(f"{path.name} was removed or replaced while it was in use; put it back, or start again")

    return look


def _failure(why: str) -> exc.OperationalError:
    """Return an error that counts as a database that cannot be used."""
    return exc.OperationalError(None, None, sqlite3.OperationalError(why))


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
    # SQLite's own knows capitals of ASCII only, and names have others.
    connection.create_function("lower", 1, _lower, deterministic=True)
    connection.execute(f"PRAGMA busy_timeout={BUSY_MS}")
    connection.execute("PRAGMA synchronous=NORMAL")


def _lower(text: Any) -> Any:
    return text.lower() if isinstance(text, str) else text
