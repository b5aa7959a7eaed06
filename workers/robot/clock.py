"""The clock by which an execution is supervised: it is asked for the time, and waits."""

from __future__ import annotations

import time
from typing import Protocol


class Clock(Protocol):
    """Time that controllers, their links and whoever supervises them share."""

    def now(self) -> float:
        """Return the time from a moment that never changes [s]."""
        ...

    def sleep(self, seconds: float) -> None:
        """Return once so much of it has passed."""
        ...


class WallClock:
    """The time of the world: that of every real controller."""

    def now(self) -> float:
        """Return the time from a moment that never changes [s]."""
        return time.monotonic()

    def sleep(self, seconds: float) -> None:
        """Return once so much of it has passed."""
        time.sleep(seconds)
