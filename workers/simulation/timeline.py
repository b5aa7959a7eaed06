"""A plan's segments on one time axis, and what lies between their samples."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from planners.geometry.pose import Array
from planners.plan.segment import Segment


@dataclass(frozen=True, eq=False)
class PlannedMoment:
    """One instant of a plan, between two samples of one segment."""

    time: float
    """[s]"""
    index: int
    """Number of the segment."""
    segment: Segment
    low: int
    high: int
    """The samples before and after it, counted over the whole plan."""
    part: float
    """How far from the first to the second, 0 to 1."""

    @property
    def elapsed(self) -> float:
        """Which part of the segment is over, 0 to 1, or more after the plan's end."""
        begin = self.segment.time[0]
        return float((self.time - begin) / max(self.segment.end - begin, 1e-9))

    def between(self, rows: Array) -> Array:
        """Return the row (k,) at this instant of rows (n, k), one a sample of the whole plan: straight between two."""
        return (1.0 - self.part) * rows[self.low] + self.part * rows[self.high]


class SampledTimeline:
    """Rows are samples of the whole plan; a segment's last has the time of the next one's first."""

    def __init__(self, segments: Sequence[Segment]) -> None:
        """Join the segments of a plan."""
        self.segments = segments
        self.time = np.concatenate([segment.time for segment in segments])
        """(n,) [s]"""
        self.positions = np.concatenate([segment.positions for segment in segments])
        self.velocities = np.concatenate([segment.velocities for segment in segments])
        """(n, 12) [rad, rad/s]"""
        self._segment_of = np.repeat(np.arange(len(segments)), [len(segment.time) for segment in segments])

    @property
    def duration(self) -> float:
        """Of the whole plan [s]."""
        return float(self.time[-1])

    def at(self, time: float) -> PlannedMoment:
        """Return the instant at a time [s]; after the end everything is as at the last sample."""
        last = len(self.time) - 1
        low = min(max(int(np.searchsorted(self.time, time, side="right")) - 1, 0), last)
        index = int(self._segment_of[low])
        # Samples on both sides of a segment's border have the same time: never interpolate over one.
        high = low + 1 if low < last and self._segment_of[low + 1] == index else low
        width = self.time[high] - self.time[low]
        part = float(min(max((time - self.time[low]) / width, 0.0), 1.0)) if width > 0.0 else 0.0
        return PlannedMoment(time, index, self.segments[index], low, high, part)

    def poses(self, body: str, start: Array) -> Array:
        """Return where a body is at every sample, (n, 7) in the world; `start` (7,): until it first moves."""
        rows = []
        for segment in self.segments:
            rows.append(segment.body_poses.get(body, np.repeat(start[None], len(segment.time), axis=0)))
            start = rows[-1][-1]
        return np.concatenate(rows)
