"""Why a node, an edge or a hold fell: counted by reason, the nearest miss of each kept."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass


@dataclass(frozen=True)
class Rejection:
    """One reason for a "no", with its numbers where it has any."""

    stage: str
    """"reach", "clearance", "balance", "transfer", "transit" or "capacity"."""
    reason: str
    """A sentence for a person."""
    where: str = ""
    needed: float | None = None
    available: float | None = None
    unit: str | None = None

    @property
    def missing(self) -> float:
        """How far the nearest miss was off; infinite where it cannot be measured."""
        if self.needed is None or self.available is None:
            return float("inf")
        return self.needed - self.available


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
