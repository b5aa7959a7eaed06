"""A database that cannot be used is told in a sentence, at the start and while it is in use."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections import namedtuple
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import cast

import psycopg
import pytest
import sqlalchemy as sa
from psycopg import sql
from sqlalchemy import event, exc
from structlog.testing import capture_logs

from tests.support.postgres import needs_postgres, running_postgres
from tests.support.service import FAKE_SOLVER, ROOT
from tests.support.worker import WorkerProcess
from workers.engine.executor_lock import AdvisoryLock, worker_lives
from workers.settings import WorkerSettings
from workers.stores import database as database_module
from workers.stores.database import SERVER_OPTIONS, SQLITE_FILE, DatabaseUnusable, open_database, server_database
from workers.stores.database_loss import DATABASE_GONE

NO_PERMISSIONS = "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0))\n"
COMMAND = "import sys; from app.cli.main import main; sys.exit(main(['keys', 'list', '--data-dir', sys.argv[1]]))"


def garbage(folder: Path) -> None:
    (folder / SQLITE_FILE).write_bytes(b"no database at all" * 1000)


def truncated(folder: Path) -> None:
    open_database(WorkerSettings(data_dir=folder)).close()
    whole = (folder / SQLITE_FILE).read_bytes()
    (folder / SQLITE_FILE).write_bytes(whole[:5000] + os.urandom(len(whole) - 5000))


def folder_in_its_place(folder: Path) -> None:
    (folder / SQLITE_FILE).mkdir()


@pytest.mark.parametrize("spoil", [garbage, truncated, folder_in_its_place])
def test_what_is_no_database_is_told_with_its_name(tmp_path: Path, spoil: Callable[[Path], None]) -> None:
    spoil(tmp_path)
    with pytest.raises(DatabaseUnusable, match=rf"{SQLITE_FILE} cannot be used: \w+"):
        open_database(WorkerSettings(data_dir=tmp_path))


def test_a_data_directory_that_cannot_be_made_is_told(tmp_path: Path) -> None:
    (tmp_path / "data").write_text("a file")
    with pytest.raises(DatabaseUnusable, match="data cannot be written to: "):
        open_database(WorkerSettings(data_dir=tmp_path / "data"))


@pytest.mark.slow
def test_a_disk_that_is_full_at_the_start_is_a_sentence_and_no_traceback(tmp_path: Path) -> None:
    """No file may grow: what the database layer sees is what it sees on a full disk."""
    command = [sys.executable, "-c", NO_PERMISSIONS + COMMAND, str(tmp_path)]
    ended = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert ended.returncode == 1
    assert "Traceback" not in ended.stderr
    assert ended.stderr.splitlines()[-1].startswith("liftwright: ")


def test_a_database_file_that_is_removed_or_replaced_counts_as_gone(tmp_path: Path) -> None:
    with closing(open_database(WorkerSettings(data_dir=tmp_path))) as database:
        database.require_writable()
        (tmp_path / SQLITE_FILE).rename(tmp_path / "aside")
        with pytest.raises(DATABASE_GONE, match="removed or replaced"):
            database.require_writable()
        assert not (tmp_path / SQLITE_FILE).exists()
        (tmp_path / SQLITE_FILE).write_bytes((tmp_path / "aside").read_bytes())
        with pytest.raises(DATABASE_GONE, match="removed or replaced"):
            database.scalar(sa.select(1))
        (tmp_path / "aside").replace(tmp_path / SQLITE_FILE)
        database.require_writable()


def test_a_disk_with_little_room_takes_no_writes_for_long(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    usage = namedtuple("usage", ("total", "used", "free"))
    with closing(open_database(WorkerSettings(data_dir=tmp_path))) as database:
        monkeypatch.setattr(database_module.shutil, "disk_usage", lambda _: usage(2**30, 2**30, 4096))
        with pytest.raises(DATABASE_GONE, match="is full"):
            database.require_writable()


@pytest.mark.parametrize("password", ["p@ss", "a/b", "a#b", "a:b", "a?b", "@/#:", "50%", "p%40ss@"])
def test_every_character_may_stand_in_a_password(tmp_path: Path, password: str) -> None:
    """The database's own library is asked what it makes of the address; %40 is an @, as RFC 3986 says."""
    url = f"postgresql://planner:{password}@db.example:6543/liftwright"
    database = server_database(WorkerSettings(data_dir=tmp_path, database_url=url))
    assert event.contains(database.engine, "do_connect", database_module._connect_to_spare)
    shared = sa.create_engine(sa.make_url(database.engine_url).set(drivername="postgresql+psycopg"))
    for engine in (database.engine, shared):
        _, named = engine.dialect.create_connect_args(engine.url)
        assert named["password"] == password.replace("%40", "@")
        assert (named["host"], named["port"], named["dbname"], named["user"]) == (
            "db.example", 6543, "liftwright", "planner",
        )  # fmt: skip


@pytest.mark.parametrize("who", ["", "planner@", "planner:p@ss?x=1@"])
def test_what_a_query_says_ends_no_password(tmp_path: Path, who: str) -> None:
    url = f"postgresql://{who}db.example/liftwright?application_name=planner@factory&options=-c%20work_mem%3D8MB"
    database = server_database(WorkerSettings(data_dir=tmp_path, database_url=url))
    _, named = database.engine.dialect.create_connect_args(database.engine.url)
    assert (named["host"], named["dbname"]) == ("db.example", "liftwright")
    assert named["application_name"] == "planner@factory"
    # What is not said is as we say it: the server takes what is set last.
    assert named["options"] == f"{SERVER_OPTIONS} -c work_mem=8MB"
    assert (named.get("user"), named.get("password")) == (
        "planner" if who else None, "p@ss?x=1" if ":" in who else None,
    )  # fmt: skip


@needs_postgres
@pytest.mark.slow
def test_a_password_beside_the_address_is_taken_as_it_is_by_all_who_connect(tmp_path: Path) -> None:
    """As docker-compose.yml gives it, the server too: `%41` is no A there. API, worker and engine connect with it."""
    password = "p%41 ss@/:#?'\\"
    with running_postgres() as server:
        with psycopg.connect(server.url, autocommit=True) as connection:
            connection.execute(sql.SQL("ALTER ROLE liftwright PASSWORD {}").format(password))
        hosts = server.folder / "pg_hba.conf"
        hosts.write_text("host all all all scram-sha-256\n")
        with psycopg.connect(server.url, autocommit=True) as connection:
            connection.execute("SELECT pg_reload_conf()")
        settings = WorkerSettings(data_dir=tmp_path, database_url=server.url, worker_name="only", worker_slots=1)
        with pytest.MonkeyPatch.context() as environment:
            environment.setattr(database_module, "START_SECONDS", 0.0)
            environment.delenv("PGPASSWORD", raising=False)
            with pytest.raises(DatabaseUnusable, match="no password"):
                open_database(settings)
            environment.setenv("PGPASSWORD", password)
            with closing(open_database(settings)) as database, closing(AdvisoryLock(database, "only")) as lock:
                database.require_writable()
                assert lock.hold()
                assert worker_lives(settings)
            worker = WorkerProcess("only", tmp_path, FAKE_SOLVER, database_url=server.url)
            worker.start().end(signal.SIGTERM)
            assert "fe_sendauth" not in worker.log
            assert "Traceback" not in worker.log


@pytest.mark.parametrize("url", ["nonsense", "mysql://u@h/d", "postgresql:/h", ""])
def test_an_address_that_is_none_is_told_as_it_must_be(tmp_path: Path, url: str) -> None:
    with pytest.raises(DatabaseUnusable, match="postgresql://USER:PASSWORD@HOST"):
        open_database(WorkerSettings(data_dir=tmp_path, database_url=url))


@pytest.mark.parametrize(
    ("where", "hosts"),
    [
        ("127.0.0.1:1/liftwright", "127.0.0.1:1"),
        ("/liftwright?host=127.0.0.1:1&host=127.0.0.1:2", "127.0.0.1:1 or 127.0.0.1:2"),
    ],
)
def test_a_server_that_is_not_there_is_told_with_where_it_was_looked_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, where: str, hosts: str
) -> None:
    monkeypatch.setattr(database_module, "START_SECONDS", 0.0)
    with pytest.raises(DatabaseUnusable, match=rf"liftwright on {hosts} cannot be used: .*refused") as told:
        open_database(WorkerSettings(data_dir=tmp_path, database_url=f"postgresql://u:secret@{where}"))
    assert "secret" not in str(told.value)


@needs_postgres
@pytest.mark.slow
def test_a_server_that_is_lost_in_the_midst_of_a_start_is_waited_for_and_each_try_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whatever of the start it is that meets the loss: each fails once, as psycopg tells of it."""
    monkeypatch.setattr(database_module, "START_PAUSE_SECONDS", 0.01)
    lost = {name: psycopg.OperationalError("server closed the connection unexpectedly") for name in ("engine", "ours")}

    def losing(name: str, call: Callable[..., None]) -> Callable[..., None]:
        def lose_once(*arguments: object) -> None:
            if (loss := lost.pop(name, None)) is not None:
                raise exc.OperationalError(None, None, loss)
            call(*arguments)

        return lose_once

    monkeypatch.setattr(database_module.DBOS, "migrate", losing("engine", database_module.DBOS.migrate))
    monkeypatch.setattr(database_module, "migrate", losing("ours", database_module.migrate))
    with running_postgres() as server, capture_logs() as told:
        with closing(open_database(WorkerSettings(data_dir=tmp_path, database_url=server.url))) as database:
            database.require_writable()
    assert lost == {}
    assert [line["event"] for line in told].count("waiting for the database") == 2


@needs_postgres
def test_a_database_of_another_encoding_is_told_with_what_to_do(tmp_path: Path) -> None:
    with running_postgres() as server:
        with psycopg.connect(server.url, autocommit=True) as connection:
            connection.execute("CREATE DATABASE ascii ENCODING 'SQL_ASCII' LOCALE 'C' TEMPLATE template0")
        url = server.url.rpartition("/")[0] + "/ascii"
        with pytest.raises(DatabaseUnusable, match="has the encoding SQL_ASCII, and must have UTF8: create it anew"):
            open_database(WorkerSettings(data_dir=tmp_path, database_url=url))


class FullServer:
    """Stands for a server's library: it has a connection to spare at a later try."""

    def __init__(self, tries: int, says: str) -> None:
        self.left, self.says = tries, says

    def connect(self) -> str:
        if self.left:
            self.left -= 1
            raise exc.OperationalError("", {}, psycopg.OperationalError(self.says))
        return "connection"


def test_a_server_without_a_connection_to_spare_is_waited_for_and_no_other_fault(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(database_module, "SPARE_LOOK_SECONDS", 0.01)
    connect = cast(Callable[..., object], database_module._connect_to_spare)
    assert connect(FullServer(3, "FATAL:  sorry, too many clients already"), None, [], {}) == "connection"
    with pytest.raises(DATABASE_GONE, match="refused"):
        connect(FullServer(1, "connection refused"), None, [], {})
    monkeypatch.setattr(database_module, "POOL_SECONDS", 0.05)
    with pytest.raises(DATABASE_GONE, match="remaining"):
        connect(FullServer(10**6, "FATAL:  remaining connection slots are reserved"), None, [], {})
