"""One worker per name: two processes that share one would run every job twice.

On SQLite the name is a locked file, on PostgreSQL an advisory lock. Kernel and server give either back when the process
that holds it ends, however it ends; so a lock that can be taken says that its worker is dead.
"""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import sqlalchemy as sa
from sqlalchemy import exc
from sqlalchemy.pool import NullPool

from planners.errors import LiftwrightError
from workers.settings import WorkerSettings
from workers.stores.database import Database, open_database

NOTICED_SECONDS = 15
"""A machine that vanishes without closing its connections is noticed by the other side after about this long [s]."""
_KEEPALIVE = {"tcp_keepalives_idle": 5, "tcp_keepalives_interval": 5, "tcp_keepalives_count": 2}


class WorkerRuns(LiftwrightError):
    """Another worker of that name is alive."""

    def __init__(self, name: str, where: str) -> None:
        super().__init__(f"a worker {name!r} already runs on {where}; stop it, or give this one another name or place")


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
        self._name = name
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

    @contextlib.contextmanager
    def borrowed(self, name: str) -> Iterator[bool]:
        """Take another worker's name for the time of a block, in which it is true if that worker is dead."""
        taken = self._take(name)
        try:
            yield taken
        finally:
            if taken:
                self._ask(sa.func.pg_advisory_unlock(_key(name)))

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
        assert self._connection is not None
        try:
            return self._connection.scalar(sa.select(expression))
        except exc.DBAPIError:
            self.close()
            raise


def worker_lives(settings: WorkerSettings) -> bool:
    """Whether somebody holds the worker's name, its lock cannot be taken, and nobody says that it is stuck."""
    if settings.embedded:
        try:
            FileLock(settings.data_dir, settings.executor_name).release()
        except WorkerRuns:
            return True
        return False
    name = settings.executor_name
    with (
        contextlib.closing(open_database(settings)) as database,
        contextlib.closing(AdvisoryLock(database, f"check of {name}")) as lock,
    ):
        lock.hold()
        with lock.borrowed(name) as dead, lock.borrowed(stuck_name(name)) as gets_on:
            return gets_on and not dead


def stuck_name(name: str) -> str:
    """Return the name that is held as well while something in a worker does not get on."""
    return f"{name} is stuck"


def _key(name: str) -> int:
    """Return the number of a worker's name, as a signed number of 64 bits."""
    return int.from_bytes(hashlib.sha256(f"liftwright worker {name}".encode()).digest()[:8], "big", signed=True)
