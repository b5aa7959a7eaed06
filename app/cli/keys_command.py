"""`liftwright keys`: issue, list and revoke keys, straight in the database that the service uses."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing, contextmanager
from datetime import UTC, datetime
from typing import Literal

from app.access.audit_log import AuditLog
from app.access.caller import Caller, Scope
from app.access.key_store import KeyRecord, KeyStore
from planners.errors import LiftwrightError
from workers.settings import WorkerSettings
from workers.stores.database import open_database
from workers.stores.tables import now_us

DAY_US = 86_400_000_000
COMMAND_LINE = Caller(None, None, Scope.ADMIN)
COLUMNS = ("id", "owner", "scope", "issued", "expires", "last used", "state")
DONE = 200


class NoSuchKey(LiftwrightError):
    """A key is to be revoked that there is not, or not any more."""

    def __init__(self, key_id: str) -> None:
        super().__init__(f"no key {key_id!r} is in use; `liftwright keys list` shows them all")


def issue_key(settings: WorkerSettings, owner: str, scope: Scope, days: float | None) -> str:
    """Return the text of a new key, which is stored nowhere."""
    with _stores(settings) as (keys, audit):
        key = keys.issue(owner, scope, None if days is None else now_us() + int(days * DAY_US))
        audit.add(COMMAND_LINE, None, "ISSUE", f"key {key.id} for {owner}, {scope.value}", DONE)
        return key.text


def revoke_key(settings: WorkerSettings, key_id: str) -> None:
    """Make a key worthless.

    Raises:
        NoSuchKey: It is so already, or never was.
    """
    with _stores(settings) as (keys, audit):
        if not keys.revoke(key_id):
            raise NoSuchKey(key_id)
        audit.add(COMMAND_LINE, None, "REVOKE", f"key {key_id}", DONE)


def list_keys(settings: WorkerSettings) -> str:
    """Return a table of all keys."""
    with _stores(settings) as (keys, _):
        rows = [COLUMNS, *(_row(record, now_us()) for record in keys.all())]
    widths = [max(len(row[column]) for row in rows) for column in range(len(COLUMNS))]
    return "\n".join("  ".join(map(str.ljust, row, widths)).rstrip() for row in rows)


@contextmanager
def _stores(settings: WorkerSettings) -> Iterator[tuple[KeyStore, AuditLog]]:
    with closing(open_database(settings)) as database:
        yield KeyStore(database), AuditLog(database)


def _row(record: KeyRecord, at_us: int) -> tuple[str, ...]:
    times = (record.created_us, record.expires_us, record.last_used_us)
    return record.id, record.owner, record.scope.value, *map(_day, times), _state(record, at_us)


def _state(record: KeyRecord, at_us: int) -> Literal["valid", "revoked", "expired"]:
    if record.revoked_us is not None:
        return "revoked"
    return "valid" if record.is_valid(at_us) else "expired"


def _day(time_us: int | None) -> str:
    return "-" if time_us is None else f"{datetime.fromtimestamp(time_us / 1e6, UTC):%Y-%m-%d %H:%M}"
