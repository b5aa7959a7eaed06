"""What a task needs against the most that there can be."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True)
class Bound:
    """What is needed against the most that there can be."""

    needed: float
    needed_as_stated: tuple[float, ...]
    """What a document may name as needed: every one of them would have to be met."""
    available: float
    second_opinion: Callable[[], float] | None = None
    """Finds what there is without the formulas that `available` comes from; None where it is but read and compared."""

    @property
    def missing(self) -> float:
        """Part of the need that cannot be met; the claim is proven where it is positive."""
        return 1.0 - self.available / self.needed
