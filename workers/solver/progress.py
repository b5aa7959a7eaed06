"""From stages with counts to one fraction of the whole that never falls."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Self

from planners.progress import Report

STAGE_SHARES: Mapping[str, Mapping[str, float]] = {
    "plate_lift": {
        "scene": 0.03,
        "sample": 0.03,
        "reach": 0.09,
        "merge": 0.03,
        "examine": 0.06,
        "search": 0.09,
        "motion": 0.15,
        "certify": 0.12,
        "simulate": 0.40,
    },
    "suction_tool": {
        "scene": 0.03,
        "handovers": 0.04,
        "suction": 0.05,
        "first regrasp": 0.12,
        "forces": 0.03,
        "certify": 0.22,
        "simulate": 0.51,
    },
}
"""About how much of a job's time each stage takes, in order [1]. They sum to one.

Graphs and motion of a suction tool are found in turns with its regrasps and are not counted apart.
"""
ADDED = {"remedies": "simulate"}
"""What is added to a verdict: remedies where there is no plan, in place of the simulation of one."""
CUP_PLACES_SHARE = 0.4
"""About how much of a job's time trying places of the cup takes, after the scene, where a task leaves it open [1]."""
UNCOUNTED_HALF = 20.0
"""A stage that does not know its total is shown half done after so many parts [1]."""


class ProgressScale:
    """Follows one job. Stages may repeat, or be unknown here: the fraction then waits."""

    def __init__(self, shares: Mapping[str, float], objects: int = 1, begun: float = 0.0) -> None:
        """Prepare.

        Args:
            shares: of each stage, in order.
            objects: how many share the stages of single objects, one after the other.
            begun: fraction that an earlier attempt had already shown.
        """
        self._shares, self._objects = shares, max(1, objects)
        self._met: dict[str, list[str]] = {}
        self.fraction = begun

    @classmethod
    def of(cls, task: Mapping[str, Any], begun: float = 0.0) -> Self:
        """Return the scale of a task as accepted."""
        shares = STAGE_SHARES[task["kind"]]
        if task["kind"] == "plate_lift" and task["cup"].get("position") is None:
            scene, *others = ((stage, (1.0 - CUP_PLACES_SHARE) * share) for stage, share in shares.items())
            shares = dict([scene, ("cup places", CUP_PLACES_SHARE), *others])
        return cls(shares, len(task.get("objects", ())), begun)

    def advance(self, report: Report) -> float:
        """Take a report and return the fraction of the whole, 0 … 1."""
        stage, done, total, name = report
        if stage in ADDED:
            # What it is about is no object, and no part of it.
            stage, name = ADDED[stage], None
        if stage in self._shares:
            stages = list(self._shares)
            before = sum(self._shares[earlier] for earlier in stages[: stages.index(stage)])
            within = min(1.0, done / total) if total > 0 else done / (done + UNCOUNTED_HALF)
            if name is not None:
                within = self._part(stage, name, within)
            self.fraction = max(self.fraction, min(1.0, before + self._shares[stage] * within))
        return self.fraction

    def _part(self, stage: str, name: str, within: float) -> float:
        """Return how much of a stage is done if an object's part is; objects that came before are done."""
        met = self._met.setdefault(stage, [])
        if name not in met:
            met.append(name)
        return min(1.0, (met.index(name) + within) / self._objects)
