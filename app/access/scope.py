"""What a key allows."""

from __future__ import annotations

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
