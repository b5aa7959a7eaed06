"""The joints of a plan document on one time axis."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planners.geometry.pose import Array

Place = tuple[int, int, float]
"""Two samples of one segment, and how far from the first to the second, 0 to 1."""


@dataclass(frozen=True, eq=False)
class SampledPlan:
    """Rows are samples; a segment's last has the time of the next one's first."""

    time: Array
    """(n,) [s]"""
    positions: Array
    velocities: Array
    """(n, 12) [rad, rad/s]"""
    segment_of: NDArray[np.int64]
    """(n,) number of the segment that a sample belongs to."""

    @staticmethod
    def joined(segments: Sequence[Mapping[str, Any]]) -> SampledPlan:
        """Join the segments of a plan document."""
        return SampledPlan(
            time=np.concatenate([segment["time"] for segment in segments]),
            positions=np.concatenate([segment["positions"] for segment in segments]),
            velocities=np.concatenate([segment["velocities"] for segment in segments]),
            segment_of=np.repeat(np.arange(len(segments)), [len(segment["time"]) for segment in segments]),
        )

    @property
    def duration(self) -> float:
        """Of the whole plan [s]."""
        return float(self.time[-1])

    def locate(self, time: float) -> Place:
        """Return between which samples a time [s] is; after the end it is at the last one."""
        last = len(self.time) - 1
        low = int(np.clip(np.searchsorted(self.time, time, side="right") - 1, 0, last))
        # Samples on both sides of a segment's border have the same time: never interpolate over one.
        high = low + 1 if low < last and self.segment_of[low + 1] == self.segment_of[low] else low
        width = self.time[high] - self.time[low]
        part = float(min(max((time - self.time[low]) / width, 0.0), 1.0)) if width > 0.0 else 0.0
        return low, high, part


def between(rows: Array, place: Place) -> Array:
    """Return the row at a place, straight between two samples."""
    low, high, part = place
    return (1.0 - part) * rows[low] + part * rows[high]
