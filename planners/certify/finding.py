"""What a check has found so far: its smallest margin, and where that is."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from planners.certify.plan_view import NumberedSegment
from planners.geometry.pose import Array
from planners.plan.scenery import JOINT_NAMES
from planners.plan.verdicts import Check

_WORST = 1e308
"""Stands for a margin that is not a number: documents carry finite numbers only."""


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

    def note_samples(self, segment: NumberedSegment, margins: Array, text: str, *, first: int = 0) -> None:
        """Keep the smallest of margins (n,) of the samples of a segment from number `first` on."""
        self.note_all(margins, lambda i: f"{segment.place(first + i)}: {text}")

    def note_joints(self, segment: NumberedSegment, margins: Array, when: str = "", *, first: int = 0) -> None:
        """Keep the smallest of margins (n, 12) of the joints at the samples of a segment from number `first` on."""
        self.note_all(margins, lambda i, j: f"{segment.place(first + i)}{when}: {JOINT_NAMES[j]}")

    def check(self) -> Check:
        """Close the finding."""
        margin = None if math.isinf(self.margin) else self.margin
        return Check(name=self.name, passed=self.margin >= 0.0, margin=margin, unit=self.unit, where=self.where)
