"""From stages with counts to one fraction of the whole that never falls."""

from __future__ import annotations

from collections.abc import Mapping

STAGE_SHARES: Mapping[str, float] = {
    "scene": 0.03,
    "sample": 0.03,
    "reach": 0.09,
    "merge": 0.03,
    "examine": 0.06,
    "search": 0.09,
    "motion": 0.15,
    "certify": 0.12,
    "simulate": 0.40,
}
"""About how much of a job's time each stage takes, in order [1]. They sum to one."""
UNCOUNTED_HALF = 20.0
"""A stage that does not know its total is shown half done after so many parts [1]."""


class ProgressScale:
    """Follows one job. Stages may repeat, or be unknown here: the fraction then waits."""

    def __init__(self, shares: Mapping[str, float] = STAGE_SHARES, begun: float = 0.0) -> None:
        """Start at the fraction `begun` that an earlier attempt had already shown."""
        self._shares = shares
        self.fraction = begun

    def advance(self, stage: str, done: int, total: int) -> float:
        """Take a report and return the fraction of the whole, 0 … 1."""
        if stage in self._shares:
            names = list(self._shares)
            before = sum(self._shares[name] for name in names[: names.index(stage)])
            within = min(1.0, done / total) if total > 0 else done / (done + UNCOUNTED_HALF)
            self.fraction = max(self.fraction, min(1.0, before + self._shares[stage] * within))
        return self.fraction
