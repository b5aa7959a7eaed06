"""The time law against optima known by hand, against finite differences, and against the plan document's rules."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.interpolate import CubicHermiteSpline
from scipy.optimize import linprog

from planners.motion.blended_path import BlendedPath, BlendSettings
from planners.motion.path import CurvePath
from planners.motion.time_law import fastest_squared_speeds, node_times, smoothed_samples
from planners.motion.timing import JointLimits, RateLimit, TimingError, TimingSettings, time_path
from planners.motion.trajectory import Trajectory, TrajectoryError, concatenate, hold_still

Array = NDArray[np.float64]

UR3E = JointLimits(
    velocity=np.radians([180.0, 180.0, 180.0, 360.0, 360.0, 360.0]),
    acceleration=np.array([5.0, 5.0, 5.0, 8.0, 8.0, 8.0]),
)


class AllFree:
    def state_free(self, q: Array) -> bool:
        return True

    def edge_free(self, q_from: Array, q_to: Array) -> bool:
        return True

    def path_free(self, path: Array) -> bool:
        return True


def polyline(waypoints: Array, reach_max: float = 0.6) -> BlendedPath:
    return BlendedPath.through(waypoints, AllFree(), BlendSettings(reach_max=reach_max))


def random_path(seed: int) -> BlendedPath:
    rng = np.random.default_rng(seed)
    steps = rng.normal(size=(rng.integers(2, 8), 6)) * rng.choice([0.05, 0.3, 1.5])
    return polyline(np.cumsum(steps, axis=0), reach_max=rng.choice([0.02, 0.1, 0.6]))


def trapezoid_duration(distance: float, velocity: float, acceleration: float) -> float:
    """Rest to rest, by hand."""
    if distance * acceleration < velocity**2:
        return 2.0 * np.sqrt(distance / acceleration)
    return distance / velocity + velocity / acceleration


def straight_optimum(step: Array, limits: JointLimits) -> float:
    """The joints of a straight line share one time law: the slowest rate of each limit counts."""
    moving = step != 0.0
    return trapezoid_duration(
        1.0,
        float((limits.velocity[moving] / np.abs(step[moving])).min()),
        float((limits.acceleration[moving] / np.abs(step[moving])).min()),
    )


def assert_within_limits(trajectory: Trajectory, limits: JointLimits) -> None:
    """At the samples, and at 25 points of every cubic between them, by SciPy's own Hermite spline."""
    assert np.all(np.abs(trajectory.velocities) <= limits.velocity)
    assert np.all(np.abs(trajectory.accelerations) <= limits.acceleration)
    spline = CubicHermiteSpline(trajectory.time, trajectory.positions, trajectory.velocities)
    fractions = np.linspace(1e-6, 1.0 - 1e-6, 25)
    t = (trajectory.time[:-1, None] + np.diff(trajectory.time)[:, None] * fractions).ravel()
    assert np.all(np.abs(spline(t, 1)) <= limits.velocity * (1.0 + 1e-9))
    assert np.all(np.abs(spline(t, 2)) <= limits.acceleration * (1.0 + 1e-9))


def assert_document_rules(trajectory: Trajectory) -> None:
    """The section Time of the plan document."""
    dt = np.diff(trajectory.time)
    assert trajectory.time[0] == 0.0
    assert np.all(dt > 0.0)
    assert np.all(dt <= 0.020)
    chord = np.diff(trajectory.positions, axis=0) / dt[:, None]
    mean = 0.5 * (trajectory.velocities[1:] + trajectory.velocities[:-1])
    assert np.abs(chord - mean).max() <= 0.02
    assert np.all(trajectory.velocities[[0, -1]] == 0.0)


@pytest.mark.parametrize("seed", range(12))
def test_random_paths_keep_the_limits_and_the_documents_rules(seed: int) -> None:
    path = random_path(seed)
    trajectory = time_path(path, UR3E)
    assert_document_rules(trajectory)
    assert_within_limits(trajectory, UR3E)
    assert np.allclose(trajectory.positions[0], path.waypoints[0], atol=1e-12)
    assert np.allclose(trajectory.positions[-1], path.waypoints[-1], atol=1e-12)


@pytest.mark.parametrize("seed", [649, 832, 974, 1279])
def test_samples_tell_of_every_acceleration_even_where_a_blend_is_passed_within_a_step(seed: int) -> None:
    """Legs of millimetres beside long ones, as shortcuts leave them: about one path in sixty had such a place."""
    rng = np.random.default_rng(seed)
    steps = rng.normal(size=(rng.integers(4, 9), 6))
    steps *= rng.choice([0.002, 0.01, 0.1, 1.0], size=(len(steps), 1))
    path = polyline(np.cumsum(steps, axis=0), reach_max=0.02)
    trajectory = time_path(path, UR3E)
    mean = np.diff(trajectory.velocities, axis=0) / np.diff(trajectory.time)[:, None]
    ends = np.stack([trajectory.accelerations[:-1], trajectory.accelerations[1:]])
    outside = np.maximum(ends.min(axis=0) - mean, mean - ends.max(axis=0))
    assert outside.max() <= 0.2 + 0.1 * np.abs(mean).max()


@pytest.mark.parametrize("seed", range(12))
def test_positions_are_the_paths_at_the_parameter_listed(seed: int) -> None:
    path = random_path(seed)
    trajectory = time_path(path, UR3E)
    assert np.array_equal(path.evaluate(trajectory.path_parameter).positions, trajectory.positions)
    assert np.all(np.diff(trajectory.path_parameter) >= 0.0)


@pytest.mark.parametrize("seed", range(12))
def test_a_straight_line_takes_the_optimal_time_and_one_smoothing_window(seed: int) -> None:
    rng = np.random.default_rng(seed)
    step = rng.normal(size=6) * rng.choice([0.02, 0.3, 3.0])
    optimum = straight_optimum(step, UR3E)
    duration = time_path(polyline(np.stack([np.zeros(6), step])), UR3E).duration
    window = TimingSettings().smoothing_time
    assert optimum <= duration <= 1.03 * (optimum + window)


def test_the_unsmoothed_law_of_a_straight_line_is_the_double_integrators() -> None:
    step = np.array([1.0, -2.0, 0.5, 3.0, 0.0, 0.1])
    s = np.linspace(0.0, 1.0, 2001)
    first = np.repeat(step[None], s.size, axis=0)
    limits = (np.repeat(a[None], s.size, axis=0) for a in (UR3E.velocity, UR3E.acceleration))
    squared = fastest_squared_speeds(s, first, np.zeros_like(first), *limits)
    assert node_times(s, squared)[-1] == pytest.approx(straight_optimum(step, UR3E), rel=1e-3)


@pytest.mark.parametrize("seed", range(3))
def test_controllable_speeds_are_those_of_the_linear_programs_of_reachability_analysis(seed: int) -> None:
    """Pham and Pham 2018: backwards the greatest x, forwards the greatest u, each by a linear program."""
    path = random_path(seed)
    s = path.grid(0.0, path.length)
    points = path.evaluate(s)
    ones = np.ones((s.size, 1))
    squared = fastest_squared_speeds(s, points.first, points.second, UR3E.velocity * ones, UR3E.acceleration * ones)

    def greatest(i: int, objective: list[float], high: float, x: float | None = None) -> Array:
        rows = np.stack([points.first[i], points.second[i]], axis=1)
        ahead = np.array([2.0 * (s[i + 1] - s[i]), 1.0])
        speed_rows = np.stack([np.zeros(6), points.first[i] ** 2], axis=1)
        a = np.vstack([rows, -rows, ahead, -ahead, speed_rows])
        b = np.concatenate([UR3E.acceleration, UR3E.acceleration, [high, 0.0], UR3E.velocity**2])
        solution = linprog(-np.array(objective), a, b, bounds=[(None, None), (0.0, None) if x is None else (x, x)])
        assert solution.success
        return solution.x

    high = np.zeros(s.size)
    for i in range(s.size - 2, -1, -1):
        high[i] = greatest(i, [0.0, 1.0], high[i + 1])[1]
    expected = np.zeros(s.size)
    for i in range(s.size - 1):
        u = greatest(i, [1.0, 0.0], high[i + 1], x=expected[i])[0]
        expected[i + 1] = min(high[i + 1], max(0.0, expected[i] + 2.0 * (s[i + 1] - s[i]) * u))
    assert np.allclose(squared, expected, rtol=1e-5, atol=1e-7)


@pytest.mark.parametrize("seed", range(12))
def test_smoothing_costs_little_more_than_its_window(seed: int) -> None:
    path = random_path(seed)
    s = path.grid(0.0, path.length)
    points = path.evaluate(s)
    ones = np.ones((s.size, 1))
    squared = fastest_squared_speeds(s, points.first, points.second, UR3E.velocity * ones, UR3E.acceleration * ones)
    optimum = float(node_times(s, squared)[-1])
    pieces = path.stops.size + 1
    window = TimingSettings().smoothing_time
    assert time_path(path, UR3E).duration <= 1.15 * (optimum + 2.0 * pieces * window)


def test_smoothing_is_the_moving_average() -> None:
    """By quadrature of the piecewise quadratic motion."""
    s = np.array([0.0, 0.3, 0.5, 1.2])
    squared = np.array([0.0, 0.5, 0.8, 0.0])
    times = node_times(s, squared)
    window = 0.25
    fine = np.linspace(-window, times[-1] + window, 400_001)
    speeds = np.interp(fine, times, np.sqrt(squared))
    motion = np.concatenate([[0.0], np.cumsum(0.5 * (speeds[1:] + speeds[:-1]) * np.diff(fine))])
    at = np.linspace(0.0, times[-1] + window, 37)
    got = smoothed_samples(s, squared, times, window, at)
    for i, t in enumerate(at):
        inside = (fine >= t - window) & (fine <= t)
        assert got[0][i] == pytest.approx(motion[inside].mean(), abs=1e-4)
        assert got[1][i] == pytest.approx(speeds[inside].mean(), abs=1e-4)
    assert np.allclose(np.gradient(got[1], at)[1:-1], got[2][1:-1], atol=0.3)


@pytest.mark.parametrize("scale", [1e-9, 1e-4, 1e-2])
def test_very_short_paths_are_timed(scale: float) -> None:
    trajectory = time_path(polyline(np.stack([np.zeros(6), np.full(6, scale)])), UR3E)
    assert_document_rules(trajectory)
    assert_within_limits(trajectory, UR3E)
    assert np.allclose(trajectory.positions[-1], scale, rtol=1e-9)


def test_a_path_of_no_length_is_a_short_rest() -> None:
    q = np.arange(6.0)
    trajectory = time_path(polyline(np.stack([q, q])), UR3E)
    assert np.array_equal(trajectory.positions, np.stack([q, q]))
    assert_document_rules(trajectory)


def test_a_curve_of_no_length_is_a_short_rest() -> None:
    trajectory = time_path(CurvePath(circle, length=0.0), UR3E)
    assert np.array_equal(trajectory.positions, np.repeat(circle(np.zeros(1)), 2, axis=0))
    assert_document_rules(trajectory)


def test_a_path_on_which_no_joint_moves_is_timed() -> None:
    trajectory = time_path(CurvePath(lambda s: np.zeros((s.size, 6)), length=1.0), UR3E)
    assert_document_rules(trajectory)
    assert np.all(np.isfinite(trajectory.velocities))


def test_a_curve_that_is_not_finite_or_jumps_is_refused_with_the_place() -> None:
    with pytest.raises(TimingError, match=r"not finite near s = 0\.\d"):
        time_path(CurvePath(lambda s: np.where(s > 0.5, np.nan, s)[:, None] * np.ones(6), length=1.0), UR3E)
    with pytest.raises(TimingError, match=r"jumps near s = 0\.[67]"):
        time_path(CurvePath(lambda s: np.where(s > 0.7, s + 0.5, s)[:, None] * np.ones(6), length=1.0), UR3E)


@pytest.mark.parametrize(
    "curve",
    [
        lambda s: np.where(s < 0.503, 0.0, 1e4),
        lambda s: 1e6 * s,
        lambda s: 1.0 / (s - 0.50137),
        lambda s: np.sin(3e4 * s),
        lambda s: np.modf(np.sin(1e7 * s) * 43758.5453)[0],
    ],
    ids=["a great jump", "far away", "a pole", "a buzz", "noise"],
)
def test_a_curve_broken_beyond_any_pace_is_refused_and_not_followed_for_ever(curve) -> None:
    """The last one is never followed, however often it is slowed; the others would take hours and gigabytes."""
    with pytest.raises(TimingError, match=r"near s = \d"):
        time_path(CurvePath(lambda s: curve(s)[:, None] * np.ones(6), length=1.0), UR3E)


def test_motion_rests_at_a_stop() -> None:
    path = polyline(np.array([[0.0] * 6, [1.0] * 6, [0.0] * 5 + [2.0]]), reach_max=0.0)
    assert path.stops.size == 1
    trajectory = time_path(path, UR3E)
    at_stop = np.flatnonzero(trajectory.path_parameter == path.stops[0])
    assert at_stop.size == 1
    assert np.all(trajectory.velocities[at_stop] == 0.0)
    assert_document_rules(trajectory)
    assert_within_limits(trajectory, UR3E)


def circle(s: Array) -> Array:
    """Six joints on ellipses; a full turn in s."""
    phases = np.array([0.0, 0.5, 1.0, 1.5, 2.0, 2.5])
    return np.array([1.0, 0.8, 0.6, 0.4, 0.9, 0.2]) * np.sin(s[:, None] + phases)


def test_a_curve_is_followed_exactly_and_within_limits() -> None:
    path = CurvePath(circle, length=2.0 * np.pi)
    trajectory = time_path(path, UR3E)
    assert np.array_equal(trajectory.positions, circle(trajectory.path_parameter))
    assert_document_rules(trajectory)
    assert_within_limits(trajectory, UR3E)


def test_velocities_and_accelerations_of_a_curve_are_those_of_its_motion_in_time() -> None:
    trajectory = time_path(CurvePath(circle, length=2.0 * np.pi), UR3E)
    t = trajectory.time
    by_difference = np.gradient(trajectory.positions, t, axis=0)[1:-1]
    assert np.abs(by_difference - trajectory.velocities[1:-1]).max() < 0.02
    by_difference = np.gradient(trajectory.velocities, t, axis=0)[1:-1]
    assert np.abs(by_difference - trajectory.accelerations[1:-1]).max() < 1.0


def test_a_rate_limit_holds_along_the_path() -> None:
    """A point that travels 0.3 m per unit of s may not move faster than 0.1 m/s."""
    path = CurvePath(circle, length=2.0 * np.pi)
    limit = RateLimit(rate=lambda s: np.full(s.size, 0.3), velocity=0.1, acceleration=0.5)
    slow, fast = time_path(path, UR3E, rate_limits=[limit]), time_path(path, UR3E)
    speed = 0.3 * np.diff(slow.path_parameter) / np.diff(slow.time)
    assert speed.max() <= 0.1 * (1.0 + 1e-9)
    assert speed.max() > 0.099
    assert slow.duration > fast.duration
    assert np.abs(np.gradient(speed, slow.time[:-1])).max() <= 0.5 * 1.01


def test_a_rate_limit_holds_where_the_rate_varies() -> None:
    """The rate of the limited quantity swings by a factor of nine along the path."""
    path = CurvePath(circle, length=2.0 * np.pi)

    def way(s: Array) -> Array:
        return 0.25 * s - 0.1 * np.cos(2.0 * s)

    limit = RateLimit(rate=lambda s: 0.25 + 0.2 * np.sin(2.0 * s), velocity=0.1)
    slow = time_path(path, UR3E, rate_limits=[limit])
    assert (np.diff(way(slow.path_parameter)) / np.diff(slow.time)).max() <= 0.1 * (1.0 + 1e-6)


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("width", [0.003, 0.03])
def test_a_rate_limit_holds_where_the_rate_is_high_for_a_moment_whatever_its_sign(width: float, sign: float) -> None:
    path = CurvePath(lambda s: np.tile(s[:, None], 6), length=1.0)
    limit = RateLimit(lambda s: sign * (1.0 + 9.0 * np.exp(-(((s - 0.5) / width) ** 2))), velocity=1.0)
    slow = time_path(path, UR3E, rate_limits=[limit])
    # Each joint is where the parameter is.
    speed = np.abs(slow.velocities[:, 0])
    assert (np.abs(limit.rate(slow.path_parameter)) * speed).max() <= 1.0 + 1e-9


def test_a_rate_limit_holds_with_what_the_square_of_the_speed_adds() -> None:
    """As of a point on a bend: what is limited changes along the path, and so does what the bend adds."""
    path = CurvePath(circle, length=2.0 * np.pi)

    def rate(s: Array) -> Array:
        return 2.0 + np.sin(s)

    def curvature(s: Array) -> Array:
        return 3.0 + 2.0 * np.cos(2.0 * s)

    limits = [RateLimit(rate, np.inf, 0.5, curvature), RateLimit(lambda s: -rate(s), np.inf, 0.5, curvature)]
    slow, fast = time_path(path, UR3E, rate_limits=limits), time_path(path, UR3E)
    s, t = slow.path_parameter, slow.time
    speed = np.gradient(s, t)
    asked = rate(s) * np.abs(np.gradient(speed, t)) + curvature(s) * speed**2
    assert asked[2:-2].max() <= 0.5 * 1.02
    assert np.median(asked) > 0.4
    assert slow.duration > fast.duration


@pytest.mark.parametrize(("velocity_scale", "acceleration_scale"), [(0.3, 1.0), (1.0, 0.1), (0.2, 0.2)])
def test_scales_lower_the_limits(velocity_scale: float, acceleration_scale: float) -> None:
    settings = TimingSettings(velocity_scale=velocity_scale, acceleration_scale=acceleration_scale)
    trajectory = time_path(random_path(3), UR3E, settings)
    assert_within_limits(
        trajectory, JointLimits(UR3E.velocity * velocity_scale, UR3E.acceleration * acceleration_scale)
    )


def test_extremes_are_those_of_scipys_spline() -> None:
    rng = np.random.default_rng(0)
    time, q, v = np.cumsum(rng.uniform(0.1, 1.0, 20)), rng.normal(size=(20, 3)), rng.normal(size=(20, 3))
    reached = Trajectory(time, q, v, np.zeros_like(v), time).extremes()
    for i in range(19):
        spline = CubicHermiteSpline(time[i : i + 2], q[i : i + 2], v[i : i + 2])
        t = np.linspace(time[i], time[i + 1], 5001)
        assert np.allclose(reached.speed[i], np.abs(spline(t, 1)).max(axis=0), rtol=1e-5)
        assert np.allclose(reached.acceleration[i], np.abs(spline(t, 2)).max(axis=0), rtol=1e-9)


def test_a_rest_is_a_trajectory_and_needs_a_duration() -> None:
    trajectory = hold_still(np.arange(6.0), 0.5)
    assert trajectory.duration == 0.5
    assert_document_rules(trajectory)
    with pytest.raises(TrajectoryError, match="above 0"):
        hold_still(np.zeros(6), 0.0)


def test_parts_that_meet_are_put_together_and_others_refused() -> None:
    first, second = hold_still(np.zeros(6), 0.3), hold_still(np.zeros(6), 0.2)
    both = concatenate([first, second])
    assert both.duration == pytest.approx(0.5)
    assert both.time.size == first.time.size + second.time.size - 1
    assert_document_rules(both)
    with pytest.raises(TrajectoryError, match="away from where"):
        concatenate([first, hold_still(np.ones(6), 0.2)])
    with pytest.raises(TrajectoryError, match="no trajectory"):
        concatenate([])


def test_timing_is_repeatable() -> None:
    path = random_path(4)
    assert np.array_equal(time_path(path, UR3E).positions, time_path(path, UR3E).positions)
