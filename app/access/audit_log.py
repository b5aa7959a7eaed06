"""Who changed what, and when."""

from __future__ import annotations

from dataclasses import dataclass

import sqlalchemy as sa

from app.access.caller import Caller
from workers.stores.database import Database
from workers.stores.tables import AUDIT, AuditRow, now_us

LONGEST_ADDRESS = LONGEST_ACTION = 64
LONGEST_TARGET = 300
"""Callers choose methods and paths, and proxies addresses: what is longer is cut."""


@dataclass(frozen=True)
class AuditEntry:
    """One thing that somebody did or tried to do."""

    number: int
    at_us: int
    """Microseconds since 1970, UTC."""
    key_id: str | None
    owner: str | None
    address: str | None
    """Where the request came from."""
    action: str
    target: str
    """The address of what it was done to."""
    status: int
    """How it was answered; 202 for a task that was accepted, also where the answer waited for its plan."""


def audit_row(caller: Caller, address: str | None, action: str, target: str, status: int) -> AuditRow:
    """Return the row that says that somebody did something now."""
    return {
        "at_us": now_us(),
        "key_id": caller.key_id,
        "owner": caller.owner,
        "address": None if address is None else address[:LONGEST_ADDRESS],
        "action": action[:LONGEST_ACTION],
        "target": target[:LONGEST_TARGET],
        "status": status,
    }


class AuditLog:
    """Only grows. Every method is one transaction."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def add(self, caller: Caller, address: str | None, action: str, target: str, status: int) -> None:
        """Keep that somebody did something."""
        self._database.write(sa.insert(AUDIT).values(audit_row(caller, address, action, target, status)))

    def newest(self, most: int, before: int | None) -> list[AuditEntry]:
        """Return at most `most` entries, newest first, from behind number `before`."""
        query = sa.select(AUDIT).order_by(AUDIT.c.number.desc()).limit(most)
        if before is not None:
            query = query.where(AUDIT.c.number < before)
        return [AuditEntry(**row) for row in self._database.mappings(query)]
