"""The certificate: what was checked, with the smallest margin of each check and where it was found."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from planners.geometry.pose import Array

_WORST = 1e308
"""Stands for a margin that is not a number: documents carry finite numbers only."""


@dataclass(frozen=True)
class Check:
    """One thing that was checked. It passes when its margin is not negative."""

    name: str
    passed: bool
    margin: float | None
    """What is left to the limit at the worst place, in `unit`; None when the plan has nothing to check."""
    unit: str
    where: str
    """The worst place: segment, time or sample, and the joint, bodies or contact."""

    def to_document(self) -> dict[str, Any]:
        """Return the check as the plan document carries it."""
        return {"name": self.name, "passed": self.passed, "margin": self.margin, "unit": self.unit, "where": self.where}


@dataclass(frozen=True)
class Certificate:
    """The verdict on one plan document."""

    checks: tuple[Check, ...]

    @property
    def passed(self) -> bool:
        """Whether every check passed (and there was one)."""
        return bool(self.checks) and all(check.passed for check in self.checks)

    @property
    def failures(self) -> tuple[Check, ...]:
        """The checks that failed."""
        return tuple(check for check in self.checks if not check.passed)

    def to_document(self) -> dict[str, Any]:
        """Return the member `certificate` of a plan document."""
        return {"passed": self.passed, "checks": [check.to_document() for check in self.checks]}


@dataclass
class Finding:
    """The smallest margin seen so far in one check, while the check is being made."""

    name: str
    unit: str
    margin: float = field(default=math.inf, init=False)
    where: str = field(default="nothing to check", init=False)

    def note(self, margin: float, where: str | Callable[[], str]) -> None:
        """Keep the margin if it is the smallest so far; a margin that is not a number counts as a failure."""
        value = float(margin) if math.isfinite(margin) else -_WORST
        if value < self.margin:
            self.margin, self.where = (value, where if isinstance(where, str) else where())

    def require(self, met: bool, where: str, complaint: str) -> None:
        """Note something that is so or not: margin 0, or -1 with the complaint."""
        self.note(0.0 if met else -1.0, where if met else f"{where}: {complaint}")

    def note_all(self, margins: Array, where: Callable[..., str]) -> None:
        """Keep the smallest of an array of margins; `where` is called with the indices of that entry."""
        if margins.size == 0:
            return
        values = np.where(np.isfinite(margins), margins, -_WORST)
        index = np.unravel_index(int(np.argmin(values)), values.shape)
        if values[index] < self.margin:
            self.margin, self.where = (float(values[index]), where(*(int(i) for i in index)))

    def check(self) -> Check:
        """Close the finding."""
        if math.isinf(self.margin):
            return Check(self.name, True, None, self.unit, self.where)
        return Check(self.name, self.margin >= 0.0, self.margin, self.unit, self.where)
