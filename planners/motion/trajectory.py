"""Joint motion in time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numba import njit
from numpy.typing import NDArray

from planners.errors import LiftwrightError


class TrajectoryError(LiftwrightError):
    """Trajectories that cannot be made or put together as asked."""


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Samples of a motion of k joints at n >= 2 times; between them the joints follow cubic Hermite polynomials."""

    time: NDArray[np.float64]
    """(n,) [s], strictly rising from 0."""
    positions: NDArray[np.float64]
    """(n, k) [rad]."""
    velocities: NDArray[np.float64]
    """(n, k) [rad/s]."""
    accelerations: NDArray[np.float64]
    """(n, k) [rad/s²]."""
    path_parameter: NDArray[np.float64]
    """(n,) the path's s at each sample: `positions` are exactly q(s)."""

    @property
    def duration(self) -> float:
        """Time from first to last sample [s]."""
        return float(self.time[-1])

    def extremes(self) -> HermiteExtremes:
        """Greatest values of the Hermite interpolant over each interval between samples."""
        return HermiteExtremes(*_hermite_extremes(self.time, self.positions, self.velocities))


@dataclass(frozen=True, eq=False)
class HermiteExtremes:
    """What the interpolant of n samples reaches between them; arrays (n - 1, k)."""

    speed: NDArray[np.float64]
    """Greatest |dq/dt|."""
    acceleration: NDArray[np.float64]
    """Greatest |d²q/dt²|."""
    velocity_mismatch: NDArray[np.float64]
    """|Δq/Δt - mean of the velocities at both ends|."""


def hold_still(q: NDArray[np.float64], duration: float, sample_step: float = 0.02) -> Trajectory:
    """Rest at q (k,) for a duration > 0 [s], sampled at least every sample_step [s].

    Raises:
        TrajectoryError: The duration is not above 0.
    """
    if duration <= 0.0:
        raise TrajectoryError(f"a rest of {duration} s was asked for; its duration must be above 0")
    n = sample_count(duration, sample_step)
    zeros = np.zeros((n, q.size))
    return Trajectory(
        np.linspace(0.0, duration, n),
        np.repeat(q[None], n, axis=0),
        zeros,
        zeros.copy(),
        np.zeros(n),
    )


def sample_count(duration: float, sample_step: float) -> int:
    """Even samples, ends included, whose steps stay below sample_step by more than times are rounded."""
    return int(np.ceil(duration / (sample_step * (1.0 - 1e-9)))) + 1


def concatenate(parts: Sequence[Trajectory]) -> Trajectory:
    """One after the other: each part starts where and as fast as the part before ended.

    Raises:
        TrajectoryError: There is no part, or two neighbours do not meet within 1e-9.
    """
    if not parts:
        raise TrajectoryError("there is no trajectory to put together")
    for before, after in pairwise(parts):
        gap = max(
            float(np.abs(before.positions[-1] - after.positions[0]).max()),
            float(np.abs(before.velocities[-1] - after.velocities[0]).max()),
        )
        if gap > 1e-9:
            raise TrajectoryError(f"a trajectory starts {gap:.3g} rad or rad/s away from where the one before ended")
    starts = np.concatenate([[0.0], np.cumsum([part.duration for part in parts])])
    return Trajectory(
        np.concatenate(
            [
                parts[0].time,
                *(p.time[1:] + t for p, t in zip(parts[1:], starts[1:-1], strict=True)),
            ]
        ),
        *(
            np.concatenate(
                [
                    getattr(parts[0], name),
                    *(getattr(part, name)[1:] for part in parts[1:]),
                ]
            )
            for name in ("positions", "velocities", "accelerations", "path_parameter")
        ),
    )


@njit(cache=True, nogil=True)
def _hermite_extremes(time, positions, velocities):
    n, k = positions.shape
    out = np.empty((3, n - 1, k))
    for i in range(n - 1):
        h = time[i + 1] - time[i]
        for j in range(k):
            q0, q1 = positions[i, j], positions[i + 1, j]
            v0, v1 = velocities[i, j], velocities[i + 1, j]
            mean = (q1 - q0) / h
            a0 = (6.0 * mean - 4.0 * v0 - 2.0 * v1) / h
            a1 = (2.0 * v0 + 4.0 * v1 - 6.0 * mean) / h
            speed = max(abs(v0), abs(v1))
            if a0 * a1 < 0.0:
                # Where the acceleration, which goes evenly from a0 to a1, is 0.
                speed = max(speed, abs(v0 + 0.5 * a0 * (a0 / (a0 - a1)) * h))
            out[0, i, j] = speed
            out[1, i, j] = max(abs(a0), abs(a1))
            out[2, i, j] = abs(mean - 0.5 * (v0 + v1))
    return out[0], out[1], out[2]
