"""Why a node, an edge or a hold fell: counted by reason, the nearest miss of each kept."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass

from planners.errors import LiftwrightError
from planners.plan.verdicts import is_shortage

CAPACITY = "capacity"
"""The stage of what a closed bound proves: how much hands and cup bear at all, and what fits at all."""
_ROUNDING = 1e-9
"""Share of what is needed below which a shortage is none [1]."""


class NoShortage(LiftwrightError):
    """The figures of a reason do not say what is short: somebody would act on them in vain."""

    def __init__(self, reason: str, needed: float | None, available: float | None, unit: str | None) -> None:
        super().__init__(
            f"a cause has needed, available and a unit, with more needed than available, or none of them; {reason!r} "
            f"has {needed}, {available} and {unit}"
        )


@dataclass(frozen=True)
class Rejection:
    """One reason for a "no", with its figures where it has any: all three of them, and more needed than available.

    Raises:
        NoShortage: The figures are others.
    """

    stage: str
    """"reach", "clearance", "balance", "transfer", "transit" or "capacity"."""
    reason: str
    """A sentence for a person."""
    where: str = ""
    needed: float | None = None
    available: float | None = None
    unit: str | None = None

    def __post_init__(self) -> None:
        needed, available, unit = self.needed, self.available, self.unit
        if needed is None and available is None and unit is None:
            return
        if needed is None or available is None or unit is None or not is_shortage(needed, available, unit):
            raise NoShortage(self.reason, needed, available, unit)

    @classmethod
    def measured(cls, stage: str, reason: str, where: str, needed: float, available: float, unit: str) -> Rejection:
        """Return a rejection with figures that were computed; without them where rounding leaves nothing short."""
        if is_shortage(needed, available, unit) and needed - available > _ROUNDING * needed:
            return cls(stage, reason, where, needed, available, unit)
        return cls(stage, reason, where)

    @property
    def missing(self) -> float:
        """Part of the need that the nearest miss could not meet [1]; infinite where it cannot be measured."""
        if self.needed is None or self.available is None:
            return math.inf
        return 1.0 - self.available / self.needed


class Rejections:
    """A tally of rejections by stage and reason."""

    def __init__(self) -> None:
        self._counts: Counter[tuple[str, str]] = Counter()
        self._nearest: dict[tuple[str, str], Rejection] = {}

    @staticmethod
    def of(rejection: Rejection) -> Rejections:
        """Return the tally of one rejection."""
        tally = Rejections()
        tally.add(rejection)
        return tally

    def add(self, rejection: Rejection, count: int = 1) -> None:
        """Count a rejection; of equal reasons the one that missed by least is remembered."""
        if count <= 0:
            return
        key = (rejection.stage, rejection.reason)
        self._counts[key] += count
        if key not in self._nearest or rejection.missing < self._nearest[key].missing:
            self._nearest[key] = rejection

    def include(self, other: Rejections) -> None:
        """Add all that another tally counted."""
        for key, count in other._counts.items():
            self.add(other._nearest[key], count)

    def counts(self) -> dict[str, int]:
        """Return `{"stage: reason": count}`, most frequent first."""
        return {f"{stage}: {reason}": count for (stage, reason), count in self._counts.most_common()}

    def most_common(self, limit: int | None = None) -> list[tuple[Rejection, int]]:
        """Return the most frequent rejections with their counts; all of them without a limit."""
        return [(self._nearest[key], count) for key, count in self._counts.most_common(limit)]
