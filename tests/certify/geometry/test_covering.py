"""What convex regions leave of a polygon, by brute force: by points that are tried one by one."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from planners.certify.geometry.cover import uncovered_point
from planners.geometry.pose import Array, rotation_from_vector

SQUARE = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
POINTS = np.random.default_rng(0).uniform(-1.0, 1.0, (4000, 2))
HAIR = 1e-9


def discs(rng: np.random.Generator, number: int, radius: float) -> Array:
    """Regular octagons about random places."""
    angles = np.arange(8) * np.pi / 4
    normals = np.column_stack([np.cos(angles), np.sin(angles)])
    places = rng.uniform(-1.0, 1.0, (number, 2))
    return np.array([np.column_stack([normals, -normals @ place - radius]) for place in places])


def strips(rng: np.random.Generator, number: int) -> Array:
    """The plane in strips across a random direction, each with a hair of its neighbours."""
    angle = rng.uniform(0.0, np.pi)
    along = np.array([np.cos(angle), np.sin(angle)])
    ends = np.concatenate([[-2.0], np.sort(rng.uniform(-0.5, 0.5, number - 1)), [2.0]])
    return np.array([[[*-along, low - HAIR], [*along, -high - HAIR]] for low, high in pairwise(ends)])


def contained(points: Array, regions: Array) -> Array:
    return np.any(np.all(np.einsum("nfd,kd->knf", regions[..., :-1], points) + regions[..., -1] <= 0.0, axis=2), axis=1)


@pytest.mark.parametrize("seed", range(20))
def test_a_square_is_covered_when_all_of_its_points_are(seed: int) -> None:
    rng = np.random.default_rng(seed)
    regions = discs(rng, 6 + 2 * seed, 0.6)
    point = uncovered_point(SQUARE, regions)
    if point is None:
        assert contained(POINTS, regions).all()
    else:
        assert np.abs(point).max() <= 1.0
        assert not contained(point[None], regions).any()


def test_both_happen_among_these() -> None:
    found = [uncovered_point(SQUARE, discs(np.random.default_rng(s), 6 + 2 * s, 0.6)) for s in range(20)]
    assert 3 <= sum(point is None for point in found) <= 17


@pytest.mark.parametrize("seed", range(10))
def test_what_is_cut_into_strips_is_covered_by_all_of_them_and_not_without_one(seed: int) -> None:
    regions = strips(np.random.default_rng(seed), 6)
    assert uncovered_point(SQUARE, regions) is None
    for k in range(len(regions)):
        point = uncovered_point(SQUARE, np.delete(regions, k, axis=0))
        assert point is not None
        assert contained(point[None], regions[k : k + 1]).all()


def test_nothing_covers_nothing_and_the_whole_plane_everything() -> None:
    assert uncovered_point(SQUARE, np.empty((0, 3, 3))) is not None
    assert uncovered_point(SQUARE, np.array([[[0.0, 0.0, -1.0]]])) is None


@pytest.mark.parametrize("seed", range(10))
def test_a_polygon_in_space_is_covered_as_it_is_in_its_plane(seed: int) -> None:
    rng = np.random.default_rng(seed)
    regions, R, place = discs(rng, 30, 0.6), rotation_from_vector(rng.normal(size=3)), rng.normal(size=3)
    normals = regions[..., :2] @ R[:, :2].T
    columns = np.dstack([normals, regions[..., 2] - normals @ place])
    point, there = uncovered_point(SQUARE, regions), uncovered_point(SQUARE @ R[:, :2].T + place, columns)
    assert (point is None) == (there is None)
