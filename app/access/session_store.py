"""Browsers that have shown a key once, and carry a cookie since."""

from __future__ import annotations

import secrets

import sqlalchemy as sa

from app.access.key_store import SECRET_BYTES, digest_of
from workers.stores.database import Database
from workers.stores.tables import SESSIONS, now_us

SESSION_SECONDS = 12 * 3600
"""A working day, after which the key is to be shown again [s]."""


class SessionStore:
    """Reads and writes sessions; their tokens are stored as hashes. Every method is one transaction."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def begin(self, key_id: str) -> str:
        """Return the token of a new session, and forget those that have ended."""
        token, now = secrets.token_urlsafe(SECRET_BYTES), now_us()
        row = {"digest": digest_of(token), "key_id": key_id, "expires_us": now + SESSION_SECONDS * 1_000_000}
        with self._database.engine.begin() as transaction:
            transaction.execute(sa.delete(SESSIONS).where(SESSIONS.c.expires_us < now))
            transaction.execute(sa.insert(SESSIONS).values(row))
        return token

    def key_id(self, token: str) -> str | None:
        """Return the id of the key that a session was begun with; None if there is no such session."""
        query = sa.select(SESSIONS.c.key_id).where(
            SESSIONS.c.digest == digest_of(token), SESSIONS.c.expires_us > now_us()
        )
        return self._database.scalar(query)

    def end(self, token: str) -> None:
        """Forget a session."""
        self._database.write(sa.delete(SESSIONS).where(SESSIONS.c.digest == digest_of(token)))
