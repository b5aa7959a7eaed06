"""Time along a path: as fast as the joints' limits allow, smooth, from rest to rest."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from planners.errors import LiftwrightError
from planners.motion.path import JointPath
from planners.motion.time_law import fastest_squared_speeds, node_times, smoothed_samples
from planners.motion.trajectory import Trajectory, concatenate, hold_still, sample_count


@dataclass(frozen=True, eq=False)
class JointLimits:
    """Greatest speed and acceleration of k joints."""

    velocity: NDArray[np.float64]
    """(k,) [rad/s], > 0."""
    acceleration: NDArray[np.float64]
    """(k,) [rad/s²], > 0."""


@dataclass(frozen=True, eq=False)
class RateLimit:
    """Limit on a scalar x that moves along with a path, such as the way a plate's centre has travelled.

    `|dx/ds · ds/dt| <= velocity` and `|dx/ds · d²s/dt² + curvature · (ds/dt)²| <= acceleration`.
    """

    rate: Callable[[NDArray[np.float64]], NDArray[np.float64]]
    """s (n,) -> dx/ds (n,), for a point p its |dp/ds|."""
    velocity: float
    """Unit of x per second; inf for none."""
    acceleration: float = np.inf
    """Unit of x per second squared; inf for none."""
    curvature: Callable[[NDArray[np.float64]], NDArray[np.float64]] = np.zeros_like
    """s (n,) -> what the square of the speed adds (n,)."""


ROUNDING = 1e-9
"""Part by which limits are undercut so that rounding cannot exceed them."""


STRETCH_MAX = 50.0
"""Slower than this a motion is not made: the path jumps where it should not."""


STRETCHES = 40
"""How often a motion is slowed as a whole before it is given up; two or three times do for smooth paths."""


REDUCTION_MAX = 2.0
"""A round lowers the limits by no more than this factor; greater excesses are those of paths that jump."""


class TimingError(LiftwrightError):
    """A path that no motion can follow: it is not finite or not smooth between its stops."""


@dataclass(frozen=True)
class TimingSettings:
    """How a path becomes a trajectory."""

    sample_step: float = 0.02
    """Longest time between samples [s] (the plan document's rule)."""
    velocity_scale: float = 1.0
    """Part of the joints' velocity limits that is used, in (0, 1]."""
    acceleration_scale: float = 1.0
    """Part of the joints' acceleration limits that is used, in (0, 1]."""
    smoothing_time: float = 0.08
    """Acceleration ramps from one bound to the other within this time, which each motion takes longer [s]."""
    velocity_mismatch: float = 0.02
    """Most |Δq/Δt - mean velocity| over a step [rad/s] (the plan document's rule)."""
    acceleration_mismatch: float = 0.18
    """Most that Δv/Δt may lie outside the accelerations at both ends of a step [rad/s²], where a blend is passed within
    it (the certificate allows 0.2) ..."""
    acceleration_fraction: float = 0.09
    """... to which this part of the largest Δv/Δt is added (0.1)."""
    longest: float = 600.0
    """Time between two stops that no motion takes unless its path is broken [s]."""
    rounds: int = 6
    """How often the motion is slowed locally, where smoothing exceeded a limit, before it is slowed as a whole."""
    tolerated_excess: float = 0.02
    """An excess not worth another round; slowing the whole motion by half of it removes it."""


def time_path(
    path: JointPath, limits: JointLimits, settings: TimingSettings | None = None, rate_limits: Sequence[RateLimit] = ()
) -> Trajectory:
    """Move along `path` from rest to rest, resting at its stops, within limits at the samples and between them.

    The time-optimal motion (`fastest_squared_speeds`) is averaged over a short moving window of time, so that the
    acceleration does not jump; where that exceeds a limit the motion is slowed, first locally, then as a whole. The
    limits hold for the samples and for the cubic Hermite polynomials between them. A path of length 0 gives two samples
    half a step apart.

    Raises:
        TimingError: The path is not finite somewhere, jumps between its stops, or is so wild that a motion along it
            would take longer than `TimingSettings.longest`.
    """
    settings = settings or TimingSettings()
    if path.length == 0.0:
        return hold_still(path.evaluate(np.zeros(1)).positions[0], 0.5 * settings.sample_step)
    knots = np.concatenate([[0.0], path.stops, [path.length]])
    return concatenate([_PieceTiming(path, (a, b), limits, settings, rate_limits).best() for a, b in pairwise(knots)])


@dataclass(frozen=True, eq=False)
class _Sampled:
    trajectory: Trajectory
    speed: NDArray[np.float64]
    """(n,) |ds/dt|."""
    rate: NDArray[np.float64]
    """(n,) d²s/dt²."""


@dataclass(frozen=True, eq=False)
class _Attempt:
    """How far a motion exceeds its limits."""

    motion: _Motion
    needed: float
    """By which factor slower it would keep them."""
    worst: float
    """The path's parameter where it exceeds them most."""

    @classmethod
    def of(
        cls, motion: _Motion, sampled: _Sampled, excess_v: NDArray[np.float64], excess_a: NDArray[np.float64]
    ) -> _Attempt:
        """Judge a motion by its speed and acceleration over their limits."""
        worst = sampled.trajectory.path_parameter[int(np.argmax(np.maximum(excess_v, excess_a)))]
        return cls(motion, max(float(excess_v.max()), float(np.sqrt(excess_a.max()))), float(worst))


class _PieceTiming:
    """The motion along the piece of a path between two stops."""

    def __init__(
        self,
        path: JointPath,
        ends: tuple[float, float],
        limits: JointLimits,
        settings: TimingSettings,
        rate_limits: Sequence[RateLimit],
    ) -> None:
        self.path, self.settings, self.rate_limits = path, settings, rate_limits
        self.velocity = limits.velocity * settings.velocity_scale
        self.acceleration = limits.acceleration * settings.acceleration_scale
        self.s = path.grid(*ends)
        points = path.evaluate(self.s)
        rates, curvatures = self._limited(self.s)
        self.first = np.hstack([points.first, rates])
        self.second = np.hstack([points.second, curvatures])
        finite = np.isfinite(self.first).all(axis=1) & np.isfinite(self.second).all(axis=1)
        if not finite.all():
            raise TimingError(f"the path is not finite near s = {self.s[np.argmin(finite)]:.6g}")
        self.rate_velocity = np.array([limit.velocity for limit in rate_limits])
        self.rate_acceleration = np.array([limit.acceleration for limit in rate_limits])

    def best(self) -> Trajectory:
        """The fastest of several attempts, each slower than the last where that one exceeded the limits."""
        slow_velocity, slow_acceleration = np.ones(self.s.size), np.ones(self.s.size)
        best, best_duration = None, np.inf
        for _ in range(self.settings.rounds):
            motion = _Motion(self, slow_velocity, slow_acceleration)
            sampled = motion.sample(1.0)
            excess_v, excess_a = self.excess(sampled)
            attempt = _Attempt.of(motion, sampled, excess_v, excess_a)
            stretch = max(1.0, attempt.needed)
            if best is None or stretch * motion.duration < best_duration:
                best, best_duration = attempt, stretch * motion.duration
            if max(excess_v.max(), excess_a.max()) <= 1.0 + self.settings.tolerated_excess:
                break
            motion.slow_where(excess_v, sampled.trajectory.time, slow_velocity)
            motion.slow_where(excess_a, sampled.trajectory.time, slow_acceleration)
        assert best is not None
        return self._within_limits(best)

    def _within_limits(self, attempt: _Attempt) -> Trajectory:
        """Slow the whole motion until nothing is exceeded. Slower means more samples, hence the loop."""
        motion, stretch = attempt.motion, max(1.0, attempt.needed)
        for _ in range(STRETCHES):
            if not (stretch < STRETCH_MAX and motion.duration * stretch <= self.settings.longest):
                break
            sampled = motion.sample(stretch)
            attempt = _Attempt.of(motion, sampled, *self.excess(sampled))
            if attempt.needed <= 1.0:
                return sampled.trajectory
            stretch *= attempt.needed * (1.0 + ROUNDING)
        raise TimingError(f"the path jumps near s = {attempt.worst:.6g}: no motion slow enough was found")

    def excess(self, sampled: _Sampled) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Speed and acceleration over their limits on each interval (n - 1,); 1 is at the limit."""
        trajectory = sampled.trajectory
        reached = trajectory.extremes()
        acceleration = np.maximum(reached.acceleration, _greater_end(np.abs(trajectory.accelerations)))
        excess_v = np.maximum(
            (reached.speed / self.velocity).max(axis=1),
            reached.velocity_mismatch.max(axis=1) / self.settings.velocity_mismatch,
        )
        excess_a = (acceleration / self.acceleration).max(axis=1)
        excess_a = np.maximum(excess_a, self._unresolved(trajectory))
        if self.rate_limits:
            rates, curvatures = self._limited(trajectory.path_parameter)
            speed, rate = sampled.speed[:, None], sampled.rate[:, None]
            rate_v = (np.abs(rates) * speed / self.rate_velocity).max(axis=1)
            rate_a = (np.abs(rates * rate + curvatures * speed**2) / self.rate_acceleration).max(axis=1)
            excess_v = np.maximum(excess_v, _greater_end(rate_v))
            excess_a = np.maximum(excess_a, _greater_end(rate_a))
        return excess_v, excess_a

    def _unresolved(self, trajectory: Trajectory) -> NDArray[np.float64]:
        """Return how much more than is allowed happens between the samples of each step (n - 1,); 1 is at the limit."""
        mean = np.diff(trajectory.velocities, axis=0) / np.diff(trajectory.time)[:, None]
        start, end = trajectory.accelerations[:-1], trajectory.accelerations[1:]
        outside = np.maximum(np.minimum(start, end) - mean, mean - np.maximum(start, end)).max(axis=1)
        settings = self.settings
        return outside / (settings.acceleration_mismatch + settings.acceleration_fraction * np.abs(mean).max())

    def _limited(self, s: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """dx/ds (n, c) of the quantities of the c rate limits, and (n, c) what the square of the speed adds to them."""
        found = [(limit.rate(s), limit.curvature(s)) for limit in self.rate_limits]
        rates, curvatures = np.array(found).reshape(-1, 2, s.size).transpose(1, 2, 0)
        return rates, curvatures


class _Motion:
    """One smoothed time law of a piece."""

    def __init__(
        self, piece: _PieceTiming, slow_velocity: NDArray[np.float64], slow_acceleration: NDArray[np.float64]
    ) -> None:
        self.piece = piece
        self.squared = fastest_squared_speeds(
            piece.s,
            piece.first,
            piece.second,
            np.concatenate([piece.velocity, piece.rate_velocity]) * slow_velocity[:, None],
            np.concatenate([piece.acceleration, piece.rate_acceleration]) * slow_acceleration[:, None],
        )
        self.times = node_times(piece.s, self.squared)
        self.duration = float(self.times[-1]) + piece.settings.smoothing_time
        if not self.duration <= piece.settings.longest:
            slowest = piece.s[int(np.argmax(np.diff(self.times)))]
            raise TimingError(f"the path is too wild near s = {slowest:.6g}: it would take {self.duration:.3g} s")

    def sample(self, stretch: float) -> _Sampled:
        """Samples of the motion made slower by the factor `stretch`."""
        piece = self.piece
        at = np.linspace(0.0, self.duration, sample_count(self.duration * stretch, piece.settings.sample_step))
        s, speed, rate = smoothed_samples(piece.s, self.squared, self.times, piece.settings.smoothing_time, at)
        s = np.clip(s, piece.s[0], piece.s[-1])
        # Rounding aside the motion ends at rest, on the path's ends.
        s[0], s[-1] = piece.s[0], piece.s[-1]
        speed[[0, -1]] = 0.0
        rate[[0, -1]] = 0.0
        speed, rate = speed / stretch, rate / stretch**2
        points = piece.path.evaluate(s)
        velocities = points.first * speed[:, None]
        accelerations = points.second * speed[:, None] ** 2 + points.first * rate[:, None]
        trajectory = Trajectory(at * stretch, points.positions, velocities, accelerations, s)
        return _Sampled(trajectory, np.abs(speed), rate)

    def slow_where(self, excess: NDArray[np.float64], time: NDArray[np.float64], factors: NDArray[np.float64]) -> None:
        """Divide the limits' factors by the excess at all grid points that the smoothed interval averages over."""
        reduction, exceeding = np.ones(factors.size), np.flatnonzero(excess > 1.0)
        begins = np.searchsorted(self.times, time[exceeding] - self.piece.settings.smoothing_time, side="left")
        ends = np.searchsorted(self.times, time[exceeding + 1], side="right")
        for begin, end, factor in zip(begins, ends, 1.0 / np.minimum(excess[exceeding], REDUCTION_MAX), strict=True):
            near = reduction[begin:end]
            np.minimum(near, factor, out=near)
        factors *= reduction


def _greater_end(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """The greater of the values (n, …) at both ends of each interval (n - 1, …)."""
    return np.maximum(values[1:], values[:-1])
