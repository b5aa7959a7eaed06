"""Clusters of near points: those that looking at every pair gives, at a cost that pairs have no part in."""

from __future__ import annotations

import tracemalloc

import networkx as nx
import numpy as np
import pytest
from scipy.spatial.distance import cdist

from planners.geometry.solid_mesh import clusters

RADIUS = 1e-3


def by_pairs(points: np.ndarray, radius: float) -> np.ndarray:
    """Join every two points that are near each other."""
    graph = nx.from_numpy_array(cdist(points, points) <= radius)
    number = np.empty(len(points), dtype=np.int64)
    for label, members in enumerate(sorted(nx.connected_components(graph), key=min)):
        number[list(members)] = label
    return number


def is_finer(fine: np.ndarray, coarse: np.ndarray) -> bool:
    """Whether every cluster of one division lies in one of the other."""
    return len(np.unique(np.column_stack([fine, coarse]), axis=0)) == len(np.unique(fine))


def heaps(seed: int) -> np.ndarray:
    """Return points that are near each other or far from each other, and nothing between, in any order."""
    rng = np.random.default_rng(seed)
    places = RADIUS * 10.0 * rng.permutation(np.stack(np.meshgrid(*[np.arange(4.0)] * 3), -1).reshape(-1, 3))[:20]
    points = np.repeat(places, rng.integers(1, 8, len(places)), axis=0)
    return rng.permutation(points + rng.uniform(-0.25, 0.25, points.shape) * RADIUS)


def clouds(seed: int) -> np.ndarray:
    """Return points at every distance from each other, some of them twice."""
    rng = np.random.default_rng(seed)
    points = rng.uniform(-1.0, 1.0, (120, 3)) * RADIUS * rng.uniform(2.0, 12.0)
    return np.vstack([points, points[:10]])


@pytest.mark.parametrize("seed", range(20))
def test_clusters_are_those_of_all_pairs_where_points_are_near_or_far(seed):
    points = heaps(seed)
    np.testing.assert_array_equal(clusters(points, RADIUS), by_pairs(points, RADIUS))


@pytest.mark.parametrize("seed", range(40))
def test_near_points_are_always_in_one_cluster_and_no_step_of_it_is_long(seed):
    points = clouds(seed)
    found = clusters(points, RADIUS)
    assert is_finer(by_pairs(points, RADIUS), found)
    assert is_finer(found, by_pairs(points, 2.0 * np.sqrt(3.0) * RADIUS))


@pytest.mark.parametrize("axis", range(3))
def test_a_chain_of_near_points_is_one_cluster_and_its_gap_parts_it(axis):
    points = np.zeros((100, 3))
    points[:, axis] = 0.9 * RADIUS * np.arange(100)
    assert clusters(points, RADIUS).max() == 0
    points[50:, axis] += 4.0 * RADIUS
    np.testing.assert_array_equal(clusters(points, RADIUS), np.arange(100) >= 50)


def test_the_end_of_a_row_of_cubes_does_not_touch_the_next_row():
    points = RADIUS * np.array([[0.0, 0.0, 9.5], [0.0, 1.5, 0.0], [9.5, 0.0, 0.0], [0.0, 9.5, 0.0], [1.5, 0.0, 4.0]])
    np.testing.assert_array_equal(clusters(points, RADIUS), by_pairs(points, RADIUS))


@pytest.mark.parametrize("spread", [0.0, 0.1, 3.0])
def test_heaped_points_take_memory_in_proportion_to_their_number(spread):
    def memory(count: int) -> int:
        points = np.random.default_rng(0).uniform(0.0, 1.0, (count, 3)) * spread * RADIUS
        tracemalloc.start()
        try:
            clusters(points, RADIUS)
            return tracemalloc.get_traced_memory()[1]
        finally:
            tracemalloc.stop()

    assert memory(40_000) < 5.0 * memory(10_000)
