"""Token buckets: so many requests at once, and so many a second after that."""

from __future__ import annotations

import time
from collections.abc import Callable

MOST_BUCKETS = 10_000
"""Buckets beyond this are forgotten, the full ones first."""


class RateLimiter:
    """One bucket for each name. Not for several threads at a time."""

    def __init__(self, per_second: float, burst: int, clock: Callable[[], float] = time.monotonic) -> None:
        """Let `burst` requests [1] through at once, and `per_second` [1/s] in the long run."""
        self._rate, self._burst, self._clock = per_second, float(burst), clock
        self._buckets: dict[str, tuple[float, float]] = {}

    @property
    def told(self) -> str:
        """What it lets through, in words."""
        return f"{self._rate:g} a second, {self._burst:g} at once"

    def take(self, name: str) -> float:
        """Let a request through and return 0, or return after how long one would be let through [s]."""
        level = self._level(name)
        if level < 1.0:
            return (1.0 - level) / self._rate
        self._put(name, level - 1.0)
        return 0.0

    def _level(self, name: str) -> float:
        level, when = self._buckets.get(name, (self._burst, 0.0))
        return min(self._burst, level + (self._clock() - when) * self._rate)

    def _put(self, name: str, level: float) -> None:
        if name not in self._buckets and len(self._buckets) >= MOST_BUCKETS:
            self._buckets = {kept: self._buckets[kept] for kept in self._buckets if self._level(kept) < self._burst}
            if len(self._buckets) >= MOST_BUCKETS:
                self._buckets.clear()
        self._buckets[name] = (level, self._clock())
