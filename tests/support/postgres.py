"""A PostgreSQL server of our own for tests, on a free port of this machine, that may be killed."""

from __future__ import annotations

import atexit
import os
import shutil
import signal
import socket
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any, LiteralString, Self

import psutil
import psycopg
import pytest

from .service import cpu_seconds, wait_for

PLACES = (*sorted(Path("/usr/lib/postgresql").glob("*/bin"), reverse=True), Path("/usr/bin"), Path("/usr/local/bin"))
BINARIES = next((place for place in PLACES if (place / "initdb").exists() and (place / "postgres").exists()), None)
NOBODY = "postgres"
"""The server refuses to run as root; Debian's package brings this account."""
needs_postgres = pytest.mark.skipif(
    BINARIES is None and "CI" not in os.environ, reason="PostgreSQL is not installed (Debian: postgresql)"
)
STARTUP_SECONDS = 60.0


class PostgresServer:
    """One server with its files in a folder of its own."""

    def __init__(self, *settings: str, follows: PostgresServer | None = None) -> None:
        """Take settings of the server, each as `name=value`, and the server that it is a standby of, if it is one."""
        self._settings = settings
        assert BINARIES is not None, "PostgreSQL is not installed"
        self._binaries = BINARIES
        self.folder = _new_folder()
        """The server's account may write there."""
        if follows is None:
            # Copied with its owner.
            subprocess.run(["cp", "-a", f"{_fresh_cluster()}/.", str(self.folder)], check=True)
        else:
            where = ("--host=127.0.0.1", f"--port={follows.port}", "--username=liftwright")
            self.run("pg_basebackup", *where, "--write-recovery-conf", "--checkpoint=fast", "-D", self.folder)
        with socket.create_server(("127.0.0.1", 0)) as probe:
            self.port = probe.getsockname()[1]
        self.process: subprocess.Popen[bytes] | None = None

    @property
    def url(self) -> str:
        """Of the database for the service; it makes it itself."""
        return f"postgresql://liftwright@127.0.0.1:{self.port}/liftwright"

    def run(self, program: str, *words: object) -> None:
        """Run one of PostgreSQL's programs as the account of the server."""
        command = [str(self._binaries / program), *map(str, words)]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL, cwd="/", **_account())

    def start(self) -> Self:
        """Start, and wait until it answers."""
        wait_for(self._runs_and_answers, STARTUP_SECONDS)
        self._make_database()
        return self

    def answers(self) -> bool:
        """Whether it takes connections."""
        try:
            self._connect("postgres").close()
        except psycopg.OperationalError:
            return False
        return True

    @contextmanager
    def with_standby(self) -> Iterator[PostgresServer]:
        """Run a standby to which this server's log is streamed; from now on nothing is committed before it is there."""
        standby = PostgresServer(*self._settings, follows=self)
        try:
            wait_for(standby._runs_and_answers, STARTUP_SECONDS)
            self._set("synchronous_standby_names", "'*'")
            wait_for(self._is_followed, 30.0)
            yield standby
        finally:
            standby.stop()
            shutil.rmtree(standby.folder)

    def promote(self) -> None:
        """Make a standby the server that takes writes, and wait until it does."""
        with self._connect("postgres") as connection:
            assert connection.execute("SELECT pg_promote()").fetchone() == (True,)

    def _is_followed(self) -> bool:
        with self._connect("postgres") as connection:
            return connection.execute("SELECT sync_state FROM pg_stat_replication").fetchall() == [("sync",)]

    def kill(self) -> None:
        """kill -9 of the server and all that serve connections, as a power failure would."""
        assert self.process is not None
        # The children notice within a moment that the postmaster is gone, and end.
        self._end(signal.SIGKILL)
        wait_for(self._quiet, 30.0)

    def stop(self) -> None:
        """Immediate shutdown: connections are cut."""
        if self.process is not None:
            self._end(signal.SIGQUIT)

    def cpu_seconds(self) -> float:
        """Return the processor time of all its processes so far, and of those that have ended [s]."""
        assert self.process is not None
        postmaster = psutil.Process(self.process.pid)
        # Those that have ended are in the postmaster's account.
        return sum(postmaster.cpu_times()[:4]) + sum(cpu_seconds(each) for each in postmaster.children())

    def owner_of(self, plan_id: str) -> str | None:
        """Return the worker that a job belongs to."""
        query = "SELECT executor_id FROM dbos.workflow_status WHERE workflow_uuid = %s"
        with self._connect("liftwright") as connection:
            found = connection.execute(query, (plan_id,)).fetchone()
        return None if found is None else found[0]

    def cut(self, worker: str) -> None:
        """End the session by which a worker proves that it lives, as a network failure would."""
        query = "SELECT pg_terminate_backend(pid) FROM pg_stat_activity WHERE application_name = %s"
        with self._connect("liftwright") as connection:
            assert connection.execute(query, (f"liftwright worker {worker}",)).fetchall() == [(True,)]

    def take_writes(self, *, takes: bool) -> None:
        """Refuse writes from now on, on connections that are open as well, as a primary that was replaced; or not."""
        self._set("default_transaction_read_only", "off" if takes else "on")
        wait_for(lambda: self._takes_writes() == takes, 10.0)

    def _set(self, name: LiteralString, value: LiteralString) -> None:
        with self._connect("postgres", "-c default_transaction_read_only=off") as connection:
            connection.autocommit = True
            connection.execute(f"ALTER SYSTEM SET {name} = {value}")
            connection.execute("SELECT pg_reload_conf()")

    def _takes_writes(self) -> bool:
        with self._connect("postgres") as connection:
            return connection.execute("SHOW transaction_read_only").fetchone() == ("off",)

    def _end(self, number: signal.Signals) -> None:
        if self.process is not None:
            self.process.send_signal(number)
            self.process.wait(timeout=60)
            self.process = None

    def _quiet(self) -> bool:
        """Whether nobody uses the files any more: a new server refuses to start before."""
        found = subprocess.run(["pgrep", "-f", f"postgres.*{self.folder}"], capture_output=True, check=False).stdout
        with socket.socket() as probe:
            listening = probe.connect_ex(("127.0.0.1", self.port)) == 0
        return not found and not listening

    def _runs_and_answers(self) -> bool:
        # It ends at once while anything is left of its last life.
        if self.process is None or self.process.poll() is not None:
            self._launch()
        return self.answers()

    def _launch(self) -> None:
        settings = ("listen_addresses=127.0.0.1", f"port={self.port}", f"unix_socket_directories={self.folder}")
        settings = (*settings, *self._settings)
        words = [word for setting in settings for word in ("-c", setting)]
        with (self.folder / "server.log").open("ab") as told:
            self.process = subprocess.Popen(
                [str(self._binaries / "postgres"), "-D", str(self.folder), *words],
                stdout=told, stderr=told, cwd="/", **_account(),
            )  # fmt: skip

    def _make_database(self) -> None:
        with self._connect("postgres") as connection:
            connection.autocommit = True
            if not connection.execute("SELECT 1 FROM pg_database WHERE datname = 'liftwright'").fetchone():
                connection.execute("CREATE DATABASE liftwright")

    def _connect(self, database: str, options: str = "") -> psycopg.Connection:
        where = {"host": "127.0.0.1", "port": self.port, "user": "liftwright", "dbname": database}
        return psycopg.connect(**where, connect_timeout=5, options=options)


def _account() -> dict[str, Any]:
    return {"user": NOBODY, "group": NOBODY, "extra_groups": ()} if os.geteuid() == 0 else {}


def _new_folder() -> Path:
    """Make a folder for the server's account; not in one of a test, for those are closed to it."""
    folder = Path(tempfile.mkdtemp(prefix="liftwright-postgres-"))
    if _account():
        shutil.chown(folder, NOBODY)
    return folder


@cache
def _fresh_cluster() -> Path:
    """Return the files of a server on which nothing was done yet, made once in a process."""
    folder = _new_folder()
    atexit.register(shutil.rmtree, folder)
    settings = ("--auth=trust", "--username=liftwright", "--no-sync", "--encoding=UTF8")
    command = [str(BINARIES / "initdb"), *settings, "-D", str(folder)]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL, cwd="/", **_account())
    return folder


@contextmanager
def running_postgres(*settings: str) -> Iterator[PostgresServer]:
    """Run a server for the time of a test, with settings of its own: each is `name=value`."""
    server = PostgresServer(*settings)
    try:
        yield server.start()
    finally:
        server.stop()
        shutil.rmtree(server.folder)
