"""Tells who calls: by the key in a header, or by the session that a browser was given for a key."""

from __future__ import annotations

import asyncio
import hashlib
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import structlog
from sqlalchemy.exc import SQLAlchemyError
from starlette.concurrency import run_in_threadpool

from app.access.audit_log import AuditLog
from app.access.caller import ANYBODY, Caller
from app.access.key_store import KeyRecord, KeyStore
from app.access.rate_limiter import RateLimiter
from app.access.session_store import SessionStore
from app.errors import KeyNeeded, TooManyRequests
from app.settings import ServiceSettings
from workers.stores.database_loss import said_by
from workers.stores.tables import now_us

COOKIE = "liftwright"
TRUSTED_SECONDS = 1.0
"""A key that was good is taken for good this long without a look at the database: so long a revoked one still opens."""
MOST_TRUSTED = 1000
UNNOTED_SECONDS = 60.0
"""So long no use of a key is noted after that has failed, so that not every request waits for it to fail again."""
FAILURES_PER_SECOND, FAILURE_BURST = 10.0, 100
"""So many wrong keys may come from one address [1/s], [1]."""
log = structlog.get_logger(__name__)


@dataclass(frozen=True)
class Credentials:
    """What a request shows."""

    key: str | None
    """Of the header `Authorization: Bearer …`."""
    session: str | None
    """Of the cookie."""

    @property
    def any(self) -> bool:
        """Whether it shows something at all."""
        return bool(self.key or self.session)

    @classmethod
    def of(cls, headers: Mapping[str, str], cookies: Mapping[str, str]) -> Credentials:
        """Read them; a header goes before a cookie."""
        scheme, _, text = headers.get("authorization", "").partition(" ")
        key = text.strip() if scheme.lower() == "bearer" else None
        return cls(key, None if "authorization" in headers else cookies.get(COOKIE))


def keys_needed(settings: ServiceSettings, keys: KeyStore) -> bool:
    """Tell whether a service asks for keys: not where only this machine can reach it, and there never was any.

    A key that has expired or was revoked is no reason to let everybody in.
    """
    return settings.authentication == "required" or not settings.is_loopback or keys.any_issued()


class Authenticator:
    """Lets in whoever holds a key, as often as the key may be used."""

    def __init__(self, keys: KeyStore, sessions: SessionStore, audit: AuditLog, limiter: RateLimiter) -> None:
        self.keys, self.sessions, self.audit = keys, sessions, audit
        self._limiter = limiter
        self._failures = RateLimiter(FAILURES_PER_SECOND, FAILURE_BURST)
        self._trusted: dict[bytes, tuple[KeyRecord, float]] = {}
        self._asked: dict[bytes, asyncio.Future[KeyRecord | None]] = {}
        self._next_note = 0.0

    @property
    def open(self) -> bool:
        """Whether no keys are asked for."""
        return False

    async def admit(self, credentials: Credentials, address: str) -> Caller:
        """Return who calls.

        Raises:
            KeyNeeded: No key is shown, or one that opens nothing.
            TooManyRequests: The key was used too often, or too many wrong ones came from the address.
        """
        record = await self._record(credentials)
        if record is not None:
            wait, limit = self._limiter.take(record.id), f"a key may be used {self._limiter.told}"
        else:
            # By address, and only here: wrong keys cost those nothing who come from the same address with good ones.
            wait = self._failures.take(address) if credentials.any else 0.0
            limit = f"wrong keys may come from one address {self._failures.told}"
        if wait > 0.0:
            raise TooManyRequests(wait, limit)
        if record is None:
            raise KeyNeeded(shown=credentials.key is not None)
        return record.caller

    async def _record(self, credentials: Credentials) -> KeyRecord | None:
        secret = credentials.key or credentials.session
        if not secret:
            return None
        name = hashlib.sha256(secret.encode()).digest()
        trusted = self._trusted.get(name)
        if trusted is not None and time.monotonic() < trusted[1]:
            return trusted[0]
        record = await self._looked_up(name, self._by_key if credentials.key else self._by_session, secret)
        if record is not None:
            if len(self._trusted) >= MOST_TRUSTED:
                self._trusted.clear()
            self._trusted[name] = (record, time.monotonic() + TRUSTED_SECONDS)
        return record

    async def _looked_up(
        self, name: bytes, look_up: Callable[[str], KeyRecord | None], secret: str
    ) -> KeyRecord | None:
        """Return what the database knows of a secret; those that show it at the same time look once."""
        asked = self._asked.get(name)
        if asked is None:
            asked = self._asked[name] = asyncio.ensure_future(run_in_threadpool(look_up, secret))
            asked.add_done_callback(lambda _: self._asked.pop(name))
        # One that gives up does not end it for the others.
        return await asyncio.shield(asked)

    def _by_key(self, secret: str) -> KeyRecord | None:
        record = self.keys.holder(secret)
        if record is not None:
            self._note_use(record)
        return record

    def _note_use(self, record: KeyRecord) -> None:
        """Note that a key was used; a database that cannot be written to is no reason to turn its holder away."""
        if time.monotonic() < self._next_note:
            return
        try:
            self.keys.note_use(record)
        except SQLAlchemyError as error:
            self._next_note = time.monotonic() + UNNOTED_SECONDS
            log.warning("use of a key not noted", key_id=record.id, error=said_by(error))

    def _by_session(self, secret: str) -> KeyRecord | None:
        key_id = self.sessions.key_id(secret)
        record = None if key_id is None else self.keys.get(key_id)
        return record if record is not None and record.is_valid(now_us()) else None

    def forget(self, secret: str) -> None:
        """Look into the database the next time that a secret is shown."""
        self._trusted.pop(hashlib.sha256(secret.encode()).digest(), None)


class OpenAccess(Authenticator):
    """Lets everybody in: for a service that only its own machine can reach."""

    @property
    def open(self) -> bool:
        """Whether no keys are asked for."""
        return True

    async def admit(self, credentials: Credentials, address: str) -> Caller:
        """Return anybody."""
        return ANYBODY
