"""Waiting for a database that is away."""

from __future__ import annotations

import asyncio
from contextlib import nullcontext
from pathlib import Path

import psycopg
import pytest
import sqlalchemy as sa
from sqlalchemy import exc

from tests.support.postgres import needs_postgres, running_postgres
from workers.settings import WorkerSettings
from workers.stores import database_loss
from workers.stores.database import open_database
from workers.stores.database_loss import DATABASE_GONE, once_it_is_there
from workers.stores.tables import TOTALS


def test_a_call_is_repeated_until_the_database_is_there(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(database_loss, "FIRST_PAUSE_SECONDS", 0.0)
    losses = [exc.OperationalError("", {}, Exception()), exc.InterfaceError("", {}, Exception()), exc.TimeoutError()]

    def call(number: int) -> int:
        if losses:
            raise losses.pop()
        return number

    assert asyncio.run(once_it_is_there(call, 7)) == 7


def test_other_errors_are_not_waited_for() -> None:
    def call() -> None:
        raise exc.IntegrityError("", {}, Exception())

    with pytest.raises(exc.IntegrityError):
        asyncio.run(once_it_is_there(call))


@needs_postgres
@pytest.mark.slow
def test_a_server_that_takes_no_writes_counts_as_gone_and_its_connections_are_not_used_again(tmp_path: Path) -> None:
    with running_postgres() as server:
        database = open_database(WorkerSettings(data_dir=tmp_path, database_url=server.url))
        own = sa.create_engine(database.engine.url)
        """As the job engine has one."""
        write = sa.insert(TOTALS).values(name="a", label="b", count=1, seconds=0.0)
        database.require_writable()
        with database.engine.connect() as connection:
            before = connection.scalar(sa.select(sa.func.pg_backend_pid()))
        server.take_writes(takes=False)
        for engine in (database.engine, own):
            with pytest.raises(DATABASE_GONE), engine.begin() as transaction:
                transaction.execute(write)
        with pytest.raises(DATABASE_GONE):
            database.require_writable()
        with database.engine.connect() as connection:
            assert connection.scalar(sa.select(sa.func.pg_backend_pid())) != before
        server.take_writes(takes=True)
        database.require_writable()
        own.dispose()
        database.close()


@needs_postgres
@pytest.mark.slow
def test_a_connection_that_has_rested_is_asked_before_it_is_used_and_one_in_use_is_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with running_postgres() as server:
        database = open_database(WorkerSettings(data_dir=tmp_path, database_url=server.url))
        for rests_for, told in ((0.0, nullcontext()), (1e6, pytest.raises(DATABASE_GONE))):
            monkeypatch.setattr("workers.stores.database.RESTED_SECONDS", rests_for)
            lost = database.scalar(sa.select(sa.func.pg_backend_pid()))
            with psycopg.connect(server.url) as other:
                assert other.execute("SELECT pg_terminate_backend(%s, 30000)", (lost,)).fetchone() == (True,)
            with told:
                assert database.scalar(sa.select(sa.func.pg_backend_pid())) != lost
            # Whoever was told may ask again.
            assert database.scalar(sa.select(sa.func.pg_backend_pid())) != lost
        database.close()


@needs_postgres
@pytest.mark.slow
def test_a_session_that_is_silent_within_a_transaction_is_ended_and_others_have_its_rows(tmp_path: Path) -> None:
    """A frozen process still answers for its connection: else nobody could ever take its jobs over."""
    with running_postgres() as server:
        database = open_database(WorkerSettings(data_dir=tmp_path, database_url=server.url))
        with database.engine.begin() as transaction:
            transaction.execute(sa.insert(TOTALS).values(name="a", label="b", count=1, seconds=0.0))
        change = sa.update(TOTALS).values(count=2)
        frozen = sa.create_engine(database.engine.url).connect()
        frozen.execute(change)
        with database.engine.begin() as transaction:
            # It waits for the row, as one that takes a job over does.
            transaction.execute(sa.text("SET LOCAL lock_timeout = '60s'"))
            transaction.execute(change)
        with pytest.raises(DATABASE_GONE):
            frozen.execute(change)
        frozen.invalidate()
        database.close()
