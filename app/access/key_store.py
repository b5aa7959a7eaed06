"""The keys that were issued, without their secrets. A key is `lwk_`, the id, which may be shown, and the secret."""

from __future__ import annotations

import hashlib
import hmac
import re
import secrets
from dataclasses import dataclass
from typing import Self

import sqlalchemy as sa

from app.access.caller import Caller, Scope
from workers.stores.database import Database
from workers.stores.tables import API_KEYS, now_us

_TEXT = re.compile(r"lwk_([0-9a-f]{12})_([A-Za-z0-9_-]{43})")
SECRET_BYTES = 32
"""Too many to be guessed, so that one round of a plain hash is enough to store it."""
USE_NOTED_US = 60_000_000
"""The last use is noted this often at most [µs]: a read must not become a write."""


@dataclass(frozen=True)
class ApiKey:
    """A key as its holder has it."""

    id: str
    secret: str

    @classmethod
    def make(cls) -> Self:
        """Return a new key."""
        return cls(secrets.token_hex(6), secrets.token_urlsafe(SECRET_BYTES))

    @classmethod
    def read(cls, text: str) -> Self | None:
        """Return the key of a text; None if it is none."""
        match = _TEXT.fullmatch(text)
        return None if match is None else cls(match[1], match[2])

    @property
    def text(self) -> str:
        """What the holder sends."""
        return f"lwk_{self.id}_{self.secret}"

    @property
    def digest(self) -> str:
        """What is stored."""
        return digest_of(self.secret)


def digest_of(secret: str) -> str:
    """Return the hash under which a secret of ours is stored."""
    return hashlib.sha256(secret.encode()).hexdigest()


@dataclass(frozen=True)
class KeyRecord:
    """What is known of a key. Times are microseconds since 1970, UTC."""

    id: str
    owner: str
    scope: Scope
    digest: str
    created_us: int
    expires_us: int | None
    last_used_us: int | None
    revoked_us: int | None

    def is_valid(self, at_us: int) -> bool:
        """Tell whether the key opens anything at a time."""
        return self.revoked_us is None and (self.expires_us is None or at_us < self.expires_us)

    @property
    def caller(self) -> Caller:
        """Whoever holds it."""
        return Caller(self.id, self.owner, self.scope)


class KeyStore:
    """Reads and writes keys. Every method is one transaction."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def issue(self, owner: str, scope: Scope, expires_us: int | None = None) -> ApiKey:
        """Return a new key; nobody can ask for it again."""
        key = ApiKey.make()
        row = {
            "id": key.id,
            "owner": owner,
            "scope": scope.value,
            "digest": key.digest,
            "created_us": now_us(),
            "expires_us": expires_us,
        }
        self._database.write(sa.insert(API_KEYS).values(row))
        return key

    def all(self) -> list[KeyRecord]:
        """Return all keys, the oldest first, those that were revoked included."""
        rows = self._database.mappings(sa.select(API_KEYS).order_by(API_KEYS.c.created_us))
        return [_record(row) for row in rows]

    def get(self, key_id: str) -> KeyRecord | None:
        """Return the record of a key."""
        found = self._database.mappings(sa.select(API_KEYS).where(API_KEYS.c.id == key_id))
        return _record(found[0]) if found else None

    def any_issued(self) -> bool:
        """Tell whether some key was ever issued, even one that opens nothing any more."""
        return self._database.scalar(sa.select(sa.exists(sa.select(API_KEYS.c.id)))) == 1

    def any_valid(self) -> bool:
        """Tell whether some key opens anything now."""
        now = now_us()
        return any(record.is_valid(now) for record in self.all())

    def revoke(self, key_id: str) -> bool:
        """Make a key worthless; tell whether there was such a key that was not."""
        update = sa.update(API_KEYS).where(API_KEYS.c.id == key_id, API_KEYS.c.revoked_us.is_(None))
        return self._database.write(update.values(revoked_us=now_us())) == 1

    def holder(self, secret: str) -> KeyRecord | None:
        """Return the record of the key that a secret is; None if it opens nothing."""
        key = ApiKey.read(secret)
        record = None if key is None else self.get(key.id)
        if key is None or record is None or not hmac.compare_digest(record.digest, key.digest):
            return None
        return record if record.is_valid(now_us()) else None

    def note_use(self, record: KeyRecord) -> None:
        """Keep when a key was last used, to the minute."""
        now = now_us()
        if record.last_used_us is not None and now - record.last_used_us < USE_NOTED_US:
            return
        self._database.write(sa.update(API_KEYS).where(API_KEYS.c.id == record.id).values(last_used_us=now))


def _record(row: sa.RowMapping) -> KeyRecord:
    return KeyRecord(**{**row, "scope": Scope(row["scope"])})
