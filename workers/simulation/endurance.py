"""When a hold that is asked for too much lets go."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class EnduranceSettings:
    """How long a hold bears more than its limit."""

    grace: float = 0.2
    """A hold lets go when it is over its limit for so long [s]."""
    burst: float = 1.3
    """Or at once above this multiple of its limit [1]."""


class Endurance:
    """Remembers for how long a hold has been over its limit."""

    def __init__(self, settings: EnduranceSettings) -> None:
        self._settings, self._over = settings, 0.0

    def lets_go(self, load: float, period: float) -> bool:
        """Tell whether a hold that was asked for `load` times its limit during a period [s] lets go."""
        self._over = self._over + period if load > 1.0 else 0.0
        return load > self._settings.burst or self._over > self._settings.grace
