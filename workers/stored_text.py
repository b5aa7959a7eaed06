"""Text in our tables: what one database takes, every one does."""

from __future__ import annotations

import sqlalchemy as sa

NUL = "\0"
REPLACEMENT = "\N{REPLACEMENT CHARACTER}"


class StoredText(sa.TypeDecorator[str]):
    """A column of text of at most so many characters.

    PostgreSQL knows no NUL and refuses whatever has one, also where it is only looked for. Such text is stored, and
    looked for, with U+FFFD in its place: an id that cannot exist is not found, and what somebody asked for is told.
    """

    impl = sa.String
    cache_ok = True

    def process_bind_param(self, value: str | None, dialect: sa.Dialect) -> str | None:
        """Return what is stored in place of `value`."""
        return None if value is None else value.replace(NUL, REPLACEMENT)
