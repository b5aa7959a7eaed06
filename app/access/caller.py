"""Whoever makes a request."""

from __future__ import annotations

from dataclasses import dataclass

from app.access.scope import Scope


@dataclass(frozen=True)
class Caller:
    """The holder of a key."""

    key_id: str | None
    """None: the service asks for no keys."""
    owner: str | None
    """To whom belongs what is made with the key; several keys may have one owner."""
    scope: Scope

    def may_see(self, owner: str | None) -> bool:
        """Tell whether what belongs to `owner` exists for this caller."""
        return self.scope is Scope.ADMIN or owner == self.owner


ANYBODY = Caller(None, None, Scope.ADMIN)
"""Whoever calls a service that asks for no keys."""
