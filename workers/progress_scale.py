"""From stages with counts to one fraction of the whole that never falls."""

from __future__ import annotations

from collections.abc import Mapping

STAGE_SHARES: Mapping[str, float] = {
    "scene": 0.02,
    "contacts": 0.05,
    "holds": 0.05,
    "graph": 0.20,
    "search": 0.08,
    "motion": 0.40,
    "certify": 0.20,
}
"""How much of a job's time each stage takes, in order [1]; from the benchmark's stage times. They sum to one."""


class ProgressScale:
    """Follows one job. Stages may repeat or come unannounced: the fraction then waits."""

    def __init__(self, shares: Mapping[str, float] = STAGE_SHARES, begun: float = 0.0) -> None:
        """Start at the fraction `begun` that an earlier attempt had already shown."""
        self._shares = shares
        self.fraction = begun

    def advance(self, stage: str, done: int, total: int) -> float:
        """Take a report and return the fraction of the whole, 0 … 1."""
        if stage in self._shares:
            before = sum(share for name, share in self._before(stage))
            within = min(1.0, done / total) if total > 0 else 0.0
            self.fraction = max(self.fraction, min(1.0, before + self._shares[stage] * within))
        return self.fraction

    def _before(self, stage: str) -> list[tuple[str, float]]:
        names = list(self._shares)
        return [(name, self._shares[name]) for name in names[: names.index(stage)]]
