"""When a key was last used is worth knowing, and not worth turning anybody away for."""

from __future__ import annotations

import asyncio
import sqlite3
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
import sqlalchemy as sa
from sqlalchemy import event

from app.access.audit_log import AuditLog
from app.access.authenticator import Authenticator, Credentials
from app.access.caller import Caller, Scope
from app.access.key_store import KeyRecord, KeyStore
from app.access.rate_limiter import RateLimiter
from app.access.session_store import SessionStore
from workers.settings import WorkerSettings
from workers.stores.database import Database, open_database


@pytest.fixture
def database(tmp_path: Path) -> Iterator[Database]:
    database = open_database(WorkerSettings(data_dir=tmp_path))
    yield database
    database.close()


def door_of(database: Database) -> Authenticator:
    return Authenticator(KeyStore(database), SessionStore(database), AuditLog(database), RateLimiter(1000.0, 1000))


class Disk:
    """What a database is on; while it is full, nothing can be written."""

    def __init__(self, database: Database) -> None:
        self.full = False
        self.refused: list[str] = []
        """Statements that were."""
        event.listen(database.engine, "checkout", self._set_up)
        event.listen(database.engine, "handle_error", self._note)

    def _set_up(self, connection: sqlite3.Connection, *_: object) -> None:
        connection.execute(f"PRAGMA query_only={int(self.full)}")

    def _note(self, context: sa.engine.ExceptionContext) -> None:
        self.refused.append(str(context.statement))


def test_a_key_opens_the_door_while_nothing_can_be_written_and_not_each_time_is_that_tried(database: Database) -> None:
    authenticator, disk = door_of(database), Disk(database)
    key = authenticator.keys.issue("mes", Scope.READ).text
    disk.full = True
    for _ in range(5):
        authenticator.forget(key)
        assert asyncio.run(authenticator.admit(Credentials(key, None), "")).owner == "mes"
    assert len(disk.refused) == 1
    assert "last_used_us" in disk.refused[0]


def test_those_that_show_a_key_at_once_look_once_and_one_that_gives_up_ends_it_for_nobody(
    database: Database, monkeypatch: pytest.MonkeyPatch
) -> None:
    authenticator = door_of(database)
    key, holder, looks = authenticator.keys.issue("mes", Scope.READ).text, authenticator.keys.holder, list[str]()
    may_look = threading.Event()

    def look(secret: str) -> KeyRecord | None:
        looks.append(secret)
        may_look.wait(30.0)
        return holder(secret)

    monkeypatch.setattr(authenticator.keys, "holder", look)

    async def come() -> list[Caller | BaseException]:
        comers = [asyncio.ensure_future(authenticator.admit(Credentials(key, None), "")) for _ in range(20)]
        while not looks:
            await asyncio.sleep(0.001)
        comers[0].cancel()
        await asyncio.sleep(0.001)
        may_look.set()
        return await asyncio.gather(*comers, return_exceptions=True)

    first, *others = asyncio.run(come())
    assert isinstance(first, asyncio.CancelledError)
    assert [each.owner for each in others if isinstance(each, Caller)] == ["mes"] * 19
    assert looks == [key]


def test_uses_are_noted_again_after_a_while(database: Database, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("app.access.authenticator.UNNOTED_SECONDS", 0.0)
    authenticator, disk = door_of(database), Disk(database)
    key = authenticator.keys.issue("mes", Scope.READ)
    for disk.full in (True, False):
        authenticator.forget(key.text)
        asyncio.run(authenticator.admit(Credentials(key.text, None), ""))
    record = authenticator.keys.get(key.id)
    assert record is not None
    assert record.last_used_us is not None
