"""Whoever makes a request, and what their key allows."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum


class Scope(Enum):
    """Each one allows all that the ones before it allow."""

    READ = "read"
    """Look at one's own plans."""
    WRITE = "write"
    """Post, cancel and delete plans, post meshes and scans, and register webhooks."""
    ADMIN = "admin"
    """All of that with everybody's plans, and read the audit log."""

    def allows(self, needed: Scope) -> bool:
        """Tell whether a key of this scope may do what needs another."""
        order = list(Scope)
        return order.index(self) >= order.index(needed)


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
