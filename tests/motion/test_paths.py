"""Blended polylines and curves given by a function."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from planners.motion.blended_path import BlendedPath, BlendSettings
from planners.motion.path import CurvePath

Array = NDArray[np.float64]


class Recording:
    """Everything is free but balls of radius r round some points; keeps the polylines asked for."""

    def __init__(self, centres: Array | None = None, radius: float = 0.0) -> None:
        self.centres, self.radius = centres, radius
        self.polylines: list[Array] = []

    def state_free(self, q: Array) -> bool:
        return self.path_free(np.stack([q, q]))

    def edge_free(self, q_from: Array, q_to: Array) -> bool:
        return self.path_free(np.stack([q_from, q_to]))

    def path_free(self, path: Array) -> bool:
        self.polylines.append(path)
        if self.centres is None:
            return True
        return all(distance_to_polyline(path, c) > self.radius for c in self.centres)


class NothingFree(Recording):
    def path_free(self, path: Array) -> bool:
        return False


def distance_to_polyline(path: Array, point: Array) -> float:
    a, step = path[:-1], np.diff(path, axis=0)
    length_squared = np.maximum(np.sum(step**2, axis=1), 1e-300)
    t = np.clip(np.sum((point - a) * step, axis=1) / length_squared, 0.0, 1.0)
    return float(np.linalg.norm(a + t[:, None] * step - point, axis=1).min())


def random_polyline(seed: int, m: int = 5, k: int = 6) -> Array:
    return np.cumsum(np.random.default_rng(seed).normal(size=(m, k)), axis=0)


@pytest.mark.parametrize("seed", range(5))
def test_derivatives_of_a_blended_path_are_those_of_its_positions(seed: int) -> None:
    path = BlendedPath.through(random_polyline(seed), Recording())
    s, h = np.linspace(1e-3, path.length - 1e-3, 400), 1e-5
    before, at, after = (path.evaluate(s + d) for d in (-h, 0.0, h))
    assert np.allclose((after.positions - before.positions) / (2 * h), at.first, atol=1e-7)
    assert np.allclose((after.first - before.first) / (2 * h), at.second, atol=1e-3)


@pytest.mark.parametrize("seed", range(5))
def test_a_blended_path_and_its_two_derivatives_do_not_jump(seed: int) -> None:
    path = BlendedPath.through(random_polyline(seed), Recording())
    assert path.stops.size == 0
    s = path.grid(0.0, path.length)
    before, after = path.evaluate(s[1:-1] - 1e-9), path.evaluate(s[1:-1] + 1e-9)
    for left, right in (
        (before.positions, after.positions),
        (before.first, after.first),
        (before.second, after.second),
    ):
        assert np.abs(right - left).max() < 1e-6


@pytest.mark.parametrize("seed", range(5))
def test_a_blended_path_begins_and_ends_where_the_polyline_does(seed: int) -> None:
    waypoints = random_polyline(seed)
    path = BlendedPath.through(waypoints, Recording())
    ends = path.evaluate(np.array([0.0, path.length])).positions
    assert np.allclose(ends, waypoints[[0, -1]], atol=1e-12)


@pytest.mark.parametrize("seed", range(5))
def test_every_point_off_the_legs_lies_beside_a_polyline_that_was_checked(seed: int) -> None:
    waypoints, checker, settings = random_polyline(seed), Recording(), BlendSettings()
    path = BlendedPath.through(waypoints, checker, settings)
    points = path.evaluate(np.linspace(0.0, path.length, 2000)).positions
    checked = [waypoints, *checker.polylines]
    distances = [min(distance_to_polyline(polyline, q) for polyline in checked) for q in points]
    assert max(distances) <= settings.chord_error


def test_a_corner_is_cut_less_where_something_is_in_the_way() -> None:
    waypoints = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]])
    blocked = Recording(np.array([[0.9, 0.1]]), 0.05)
    free, tight = BlendedPath.through(waypoints, Recording()), BlendedPath.through(waypoints, blocked)
    assert 0.0 < tight.reaches[1] < free.reaches[1]
    points = tight.evaluate(np.linspace(0.0, tight.length, 1000)).positions
    assert min(np.linalg.norm(points - [0.9, 0.1], axis=1)) > 0.05


def test_a_corner_that_cannot_be_cut_is_a_stop() -> None:
    waypoints = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]])
    path = BlendedPath.through(waypoints, NothingFree())
    assert np.array_equal(path.stops, [1.0])
    assert np.array_equal(path.evaluate(path.stops).positions, waypoints[1:2])


def test_neighbouring_corners_share_a_short_leg() -> None:
    zigzag = 0.2 * np.array([[i, i % 2] for i in range(8)], dtype=float)
    assert BlendedPath.through(zigzag, Recording()).stops.size == 0


def test_repeated_waypoints_change_nothing() -> None:
    waypoints = random_polyline(0)
    doubled = np.repeat(waypoints, 2, axis=0)
    plain, repeated = (BlendedPath.through(w, Recording()) for w in (waypoints, doubled))
    assert np.array_equal(plain.waypoints, repeated.waypoints)
    assert np.array_equal(plain.reaches, repeated.reaches)


def test_a_curve_is_exact_in_position_and_accurate_in_its_derivatives() -> None:
    path = CurvePath(lambda s: np.stack([np.sin(3 * s), np.exp(0.5 * s)], axis=1), length=2.0)
    s = np.linspace(0.0, 2.0, 101)
    points = path.evaluate(s)
    assert np.array_equal(points.positions, path.function(s))
    assert np.allclose(points.first, np.stack([3 * np.cos(3 * s), 0.5 * np.exp(0.5 * s)], axis=1), atol=1e-4)
    inner = slice(1, -1)
    second = np.stack([-9 * np.sin(3 * s), 0.25 * np.exp(0.5 * s)], axis=1)
    assert np.allclose(points.second[inner], second[inner], atol=1e-3)


def test_a_curve_is_never_asked_beyond_its_ends_nor_differenced_across_a_stop() -> None:
    asked: list[Array] = []

    def bent(s: Array) -> Array:
        asked.append(s)
        return np.abs(s - 1.0)[:, None]

    path = CurvePath(bent, length=3.0, stops=np.array([1.0]))
    s = np.concatenate([np.linspace(0.0, 3.0, 301), [1.0 - 1e-9, 1.0 + 1e-9]])
    first = path.evaluate(s).first[:, 0]
    assert min(a.min() for a in asked) >= 0.0
    assert max(a.max() for a in asked) <= 3.0
    assert np.allclose(first, np.where(s < 1.0, -1.0, 1.0), atol=1e-9)
