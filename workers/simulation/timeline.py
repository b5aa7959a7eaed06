"""A plan's segments on one time axis, and what lies between their samples."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numba import njit

from planners.geometry.linear import row_between
from planners.geometry.pose import Array
from planners.plan.segment import Segment

_AT_ONCE = 256
"""Instants that are looked up together [1]."""


class PlannedMoment(NamedTuple):
    """One instant of a plan, between two samples of one segment."""

    time: float
    """[s]"""
    number: int
    """Of the segment, from 0."""
    segment: Segment
    low: int
    high: int
    """The samples before and after it, counted over the whole plan."""
    part: float
    """How far from the first to the second, 0 to 1."""
    row: Array
    """What the timeline has in its table, at this instant."""

    @property
    def positions(self) -> Array:
        """(12,) of all joints [rad]."""
        return self.row[:12]

    @property
    def velocities(self) -> Array:
        """(12,) of all joints [rad/s]."""
        return self.row[12:24]

    @property
    def elapsed(self) -> float:
        """Which part of the segment is over, 0 to 1, or more after the plan's end."""
        begin = self.segment.time[0]
        return float((self.time - begin) / max(self.segment.end - begin, 1e-9))

    def between(self, rows: Array) -> Array:
        """Return the row (k,) at this instant of rows (n, k), one a sample of the whole plan: straight between two."""
        return row_between(rows, self.low, self.high, self.part)


class SampledTimeline:
    """Rows are samples of the whole plan; a segment's last has the time of the next one's first."""

    def __init__(self, segments: Sequence[Segment]) -> None:
        """Join the segments of a plan."""
        self.segments = segments
        self.time = np.concatenate([segment.time for segment in segments])
        """(n,) [s]"""
        self.table = np.concatenate([np.hstack([each.positions, each.velocities]) for each in segments])
        """(n, k) what is looked up at every step, straight between samples: joint positions, velocities, and more."""
        # Lists: every step asks for single numbers.
        self._times = self.time.tolist()
        self._segment_of = [index for index, segment in enumerate(segments) for _ in segment.time]
        self._last = len(self._times) - 1

    @property
    def duration(self) -> float:
        """Of the whole plan [s]."""
        return float(self.time[-1])

    def at(self, time: float) -> PlannedMoment:
        """Return the instant at a time [s]; after the end everything is as at the last sample."""
        times = self._times
        low = min(max(bisect_right(times, time) - 1, 0), self._last)
        index = self._segment_of[low]
        # Samples on both sides of a segment's border have the same time: never interpolate over one.
        high = low + 1 if low < self._last and self._segment_of[low + 1] == index else low
        width = times[high] - times[low]
        part = min(max((time - times[low]) / width, 0.0), 1.0) if width > 0.0 else 0.0
        row = row_between(self.table, low, high, part)
        return PlannedMoment(time, index, self.segments[index], low, high, part, row)

    def every(self, step: float) -> Iterator[PlannedMoment]:
        """Yield what `at` returns for 0, `step`, twice that and so on [s], each time the one before plus `step`.

        It never ends; after the plan's end everything is as at the last sample.
        """
        segment_of, low, time = np.array(self._segment_of), 0, 0.0
        while True:
            times, parts = np.empty(_AT_ONCE), np.empty(_AT_ONCE)
            samples, rows = np.empty((_AT_ONCE, 2), dtype=np.int64), np.empty((_AT_ONCE, self.table.shape[1]))
            low, time = _walk(self.time, segment_of, self.table, low, time, step, times, samples, parts, rows)
            for now, (before, after), part, row in zip(
                times.tolist(), samples.tolist(), parts.tolist(), rows, strict=True
            ):
                number = self._segment_of[before]
                yield PlannedMoment(now, number, self.segments[number], before, after, part, row)

    def poses(self, body: str, start: Array) -> Array:
        """Return where a body is at every sample, (n, 7) in the world; `start` (7,): until it first moves."""
        rows = []
        for segment in self.segments:
            rows.append(segment.body_poses.get(body, np.repeat(start[None], len(segment.time), axis=0)))
            start = rows[-1][-1]
        return np.concatenate(rows)


@njit(cache=True, nogil=True)
def _walk(  # noqa: PLR0913 - one compiled pass
    sample_times, segment_of, table, low, time, step, times, samples, parts, rows
):
    """Write instants, the samples around them, how far they are between those, and their rows, see `at`.

    Args:
        sample_times: (n,) [s].
        segment_of: (n,) number of each sample's segment.
        table: (n, k).
        low: a sample that is not after the first instant.
        time: the first instant [s].
        step: from one to the next [s].
        times: (m,), written.
        samples: (m, 2), written.
        parts: (m,), written.
        rows: (m, k), written.

    Returns:
        The sample and the instant with which to go on.
    """
    last = len(sample_times) - 1
    for i in range(len(times)):
        while low < last and sample_times[low + 1] <= time:
            low += 1
        high = low + 1 if low < last and segment_of[low + 1] == segment_of[low] else low
        width = sample_times[high] - sample_times[low]
        part = min(max((time - sample_times[low]) / width, 0.0), 1.0) if width > 0.0 else 0.0
        times[i], samples[i, 0], samples[i, 1], parts[i] = time, low, high, part
        for j in range(table.shape[1]):
            rows[i, j] = (1.0 - part) * table[low, j] + part * table[high, j]
        time += step
    return low, time
