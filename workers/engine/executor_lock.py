"""One worker per name: two processes that share one would run every job twice.

On SQLite the name is a locked file, on PostgreSQL an advisory lock. Kernel and server give either back when the process
that holds it ends, however it ends; so a lock that can be taken says that its worker is dead.
"""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import os
from collections.abc import Collection, Iterable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import sqlalchemy as sa
from sqlalchemy import exc
from sqlalchemy.pool import NullPool

from planners.errors import LiftwrightError
from workers.engine.deadline import PatientQuestion
from workers.settings import WorkerSettings
from workers.stores.database import Database, server_database
from workers.stores.database_loss import DATABASE_GONE, said_by

CHECK_CONNECT_SECONDS = 2
CHECK_SECONDS = 5.0
"""So long it is asked whether a worker lives [s]; who watches containers gives up after fifteen."""
_KEEPALIVE = {"tcp_keepalives_idle": 5, "tcp_keepalives_interval": 5, "tcp_keepalives_count": 2}


class WorkerRuns(LiftwrightError):
    """Another worker of that name is alive."""

    def __init__(self, name: str, where: str) -> None:
        super().__init__(f"a worker {name!r} already runs on {where}; stop it, or give this one another name or place")


class CannotTell(LiftwrightError):
    """Nobody knows whether a worker lives."""

    def __init__(self, why: str) -> None:
        super().__init__(f"the database cannot be asked whether the worker lives: {why}")


class FileLock:
    """A name in a data directory."""

    def __init__(self, directory: Path, name: str) -> None:
        """Take the lock.

        Raises:
            WorkerRuns: Somebody else has it.
        """
        directory.mkdir(parents=True, exist_ok=True)
        self._descriptor = os.open(directory / f"worker-{name}.lock", os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
        try:
            fcntl.flock(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(self._descriptor)
            raise WorkerRuns(name, str(directory)) from None

    def release(self) -> None:
        """Let another worker have the name."""
        os.close(self._descriptor)


class AdvisoryLock:
    """A worker's name on a PostgreSQL server, held by a connection of its own. Not for two threads at once.

    Every method raises what the database raises when it cannot be reached, and has then lost the name.
    """

    def __init__(self, database: Database, name: str) -> None:
        self._name, self._database = name, database
        shown = {"application_name": f"liftwright worker {name}"}
        self._engine = sa.create_engine(database.engine.url, poolclass=NullPool, connect_args=shown)
        self._connection: sa.Connection | None = None
        self._held = self._stuck_shown = False

    def hold(self) -> bool:
        """Whether the name is ours: it still is, or was free and could be taken (again)."""
        if self._connection is None:
            self._connection, self._held, self._stuck_shown = self._connect(), False, False
        # While the connection lives, nobody can take from it what it holds.
        self._held = bool(self._ask(sa.true())) if self._held else self._take(self._name)
        return self._held

    def hold_at_start(self) -> bool:
        """Do what `hold` does, and wait for a server that is away as a start does."""
        return self._database.at_start(self.hold)

    @contextlib.contextmanager
    def borrowed(self, name: str) -> Iterator[bool]:
        """Take another worker's name for the time of a block, in which it is true if that worker is dead."""
        taken = self._take(name)
        try:
            yield taken
        finally:
            if taken:
                self._ask(sa.func.pg_advisory_unlock(_key(name)))

    def silences(self, names: Collection[str]) -> dict[str, float]:
        """Return for how long the workers that hold names have said nothing on their connections [s].

        They say something at each look, so that one which is frozen is told from one which lives: the server keeps both
        connections. By the server's clock; a name that nobody holds is left out. All are asked for at once: if each of
        many workers asked after each of the others, the server would do little else.
        """
        keys = {_halves(_key(name)): name for name in names}
        if not keys:
            return {}
        quiet = sa.func.extract("epoch", sa.func.clock_timestamp() - _SESSIONS.c.state_change)
        query = (
            sa.select(_HIGH, _LOW, sa.func.min(quiet))
            .select_from(_SESSIONS.join(_LOCKS, _LOCKS.c.pid == _SESSIONS.c.pid))
            .where(*_held(keys))
            .group_by(_HIGH, _LOW)
        )
        found = [tuple(row) for row in self._ask_rows(query)]
        return {keys[high, low]: float(seconds) for high, low, seconds in found}

    def end_session(self, name: str) -> bool:
        """End the connection by which a worker holds its name, which frees it; tell whether there was one."""
        held = _held([_halves(_key(name))])
        ended = sa.select(sa.func.bool_or(sa.func.pg_terminate_backend(_LOCKS.c.pid))).where(*held)
        return bool(self._ask(ended.scalar_subquery()))

    def show_stuck(self, *, stuck: bool) -> None:
        """Say to whoever asks that something in this worker does not get on, or that all does: by a second lock."""
        # Held at most once: the server counts.
        if stuck and not self._stuck_shown:
            self._stuck_shown = self._take(stuck_name(self._name))
        elif self._stuck_shown and not stuck:
            self._ask(sa.func.pg_advisory_unlock(_key(stuck_name(self._name))))
            self._stuck_shown = False

    def close(self) -> None:
        """Give the name back."""
        if self._connection is not None:
            with contextlib.suppress(exc.DBAPIError):
                self._connection.close()
        self._connection = None
        self._engine.dispose()

    def _connect(self) -> sa.Connection:
        connection = self._engine.connect().execution_options(isolation_level="AUTOCOMMIT")
        for setting, value in _KEEPALIVE.items():
            connection.execute(sa.select(sa.func.set_config(setting, str(value), False)))
        return connection

    def _take(self, name: str) -> bool:
        return bool(self._ask(sa.func.pg_try_advisory_lock(_key(name))))

    def _ask(self, expression: sa.ColumnElement[Any]) -> Any:
        return self._ask_rows(sa.select(expression))[0][0]

    def _ask_rows(self, query: sa.Executable) -> Sequence[sa.Row[Any]]:
        assert self._connection is not None
        try:
            return self._connection.execute(query).all()
        except exc.DBAPIError:
            self.close()
            raise


def worker_lives(settings: WorkerSettings) -> bool:
    """Whether somebody holds the worker's name and has just proved it, and nobody says that it is stuck.

    Raises:
        CannotTell: The database does not say so in time.
        DatabaseUnusable: Its address is none.
    """
    if settings.embedded:
        try:
            FileLock(settings.data_dir, settings.executor_name).release()
        except WorkerRuns:
            return True
        return False
    database = server_database(settings, CHECK_CONNECT_SECONDS)
    try:
        return PatientQuestion(partial(_proves_life, database, settings)).within(CHECK_SECONDS)
    except TimeoutError:
        raise CannotTell(f"it has not answered within {CHECK_SECONDS:g} s") from None
    except DATABASE_GONE as error:
        raise CannotTell(said_by(error).strip().partition("\n")[0]) from error


def _proves_life(database: Database, settings: WorkerSettings) -> bool:
    name = settings.executor_name
    with (
        contextlib.closing(database),
        contextlib.closing(AdvisoryLock(database, f"check of {name}")) as lock,
    ):
        lock.hold()
        with lock.borrowed(name) as dead, lock.borrowed(stuck_name(name)) as gets_on:
            return gets_on and not dead and lock.silences([name]).get(name, 0.0) < settings.frozen_seconds


def stuck_name(name: str) -> str:
    """Return the name that is held as well while something in a worker does not get on."""
    return f"{name} is stuck"


_LOCKS = sa.table(
    "pg_locks", *map(sa.column, ("pid", "locktype", "granted", "classid", "objid", "objsubid", "database"))
)
_SESSIONS = sa.table("pg_stat_activity", sa.column("pid"), sa.column("state_change"))


_HIGH, _LOW = (sa.cast(column, sa.BigInteger) for column in (_LOCKS.c.classid, _LOCKS.c.objid))
"""Both halves of a lock's key."""


def _held(keys: Iterable[tuple[int, int]]) -> tuple[sa.ColumnElement[bool], ...]:
    """Return what holds of the locks of some keys in the server's list of locks."""
    here = sa.select(sa.column("oid")).select_from(sa.table("pg_database"))
    return (
        _LOCKS.c.locktype == "advisory",
        _LOCKS.c.granted,
        sa.tuple_(_HIGH, _LOW).in_(list(keys)),
        _LOCKS.c.objsubid == 1,
        _LOCKS.c.database == here.where(sa.column("datname") == sa.func.current_database()).scalar_subquery(),
    )


def _halves(key: int) -> tuple[int, int]:
    """Return both halves of a key, as the server's list of locks has them."""
    return (key >> 32) & 0xFFFFFFFF, key & 0xFFFFFFFF


def _key(name: str) -> int:
    """Return the number of a worker's name, as a signed number of 64 bits."""
    return int.from_bytes(hashlib.sha256(f"liftwright worker {name}".encode()).digest()[:8], "big", signed=True)
