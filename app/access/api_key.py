"""The text of a key: `lwk_`, the id that may be shown, and the secret that may not."""

from __future__ import annotations

import hashlib
import re
import secrets
from dataclasses import dataclass
from typing import Self

_TEXT = re.compile(r"lwk_([0-9a-f]{12})_([A-Za-z0-9_-]{43})")
SECRET_BYTES = 32
"""Too many to be guessed, so that one round of a plain hash is enough to store it."""


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
