"""Convex polygons against scipy's hulls and halfspace intersections."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import ConvexHull, HalfspaceIntersection

from planners.geometry.polygon import (
    ShapeError,
    area,
    centroid,
    convex_outline,
    depth_inside,
    inward_normals,
    overlap,
    segment_distance,
    side_directions,
    side_lengths,
)


def random_outline(seed: int) -> np.ndarray:
    points = np.random.default_rng(seed).normal(size=(12, 2))
    return convex_outline(points[ConvexHull(points).vertices])


def halfspaces(outline: np.ndarray) -> np.ndarray:
    normals = -inward_normals(outline)
    return np.column_stack([normals, -np.sum(normals * outline, axis=1)])


@pytest.mark.parametrize("seed", range(10))
def test_area_is_that_of_the_hull(seed):
    outline = random_outline(seed)
    assert area(outline) == pytest.approx(ConvexHull(outline).volume)


@pytest.mark.parametrize("seed", range(10))
def test_centroid_is_the_mean_of_triangles_weighted_by_area(seed):
    outline = random_outline(seed)
    triangles = [np.array([outline[0], outline[k], outline[k + 1]]) for k in range(1, len(outline) - 1)]
    weights = np.array([area(triangle) for triangle in triangles])
    means = np.array([triangle.mean(axis=0) for triangle in triangles])
    assert centroid(outline) == pytest.approx(weights @ means / weights.sum())


@pytest.mark.parametrize("seed", range(10))
def test_sides_close_and_normals_point_at_the_inside(seed):
    outline = random_outline(seed)
    sides = side_directions(outline) * side_lengths(outline)[:, None]
    assert sides.sum(axis=0) == pytest.approx(np.zeros(2))
    middles = outline + 0.5 * sides
    assert np.all(depth_inside(outline, middles + 1e-6 * inward_normals(outline)) > 0.0)
    assert np.all(depth_inside(outline, middles - 1e-6 * inward_normals(outline)) < 0.0)


@pytest.mark.parametrize("seed", range(10))
def test_overlap_is_the_intersection_of_the_halfspaces(seed):
    one, other = random_outline(seed), random_outline(seed + 100) + 0.3
    expected = HalfspaceIntersection(np.vstack([halfspaces(one), halfspaces(other)]), np.zeros(2) + 0.15)
    hull = ConvexHull(np.unique(np.round(expected.intersections, 9), axis=0))
    corners = overlap(one, other)
    assert area(corners) == pytest.approx(hull.volume)
    assert np.min(depth_inside(one, corners)) > -1e-9
    assert np.min(depth_inside(other, corners)) > -1e-9


def test_overlap_of_polygons_that_are_apart_is_empty():
    outline = random_outline(0)
    assert len(overlap(outline, outline + 100.0)) == 0


@pytest.mark.parametrize("seed", range(5))
def test_overlap_of_a_polygon_with_itself_is_itself(seed):
    outline = random_outline(seed)
    assert overlap(outline, outline) == pytest.approx(outline)


def test_overlap_with_a_polygon_around_it_is_the_polygon_itself():
    outline = random_outline(1)
    around = convex_outline([[-9, -9], [9, -9], [9, 9], [-9, 9]])
    assert overlap(outline, around) == pytest.approx(outline)


@pytest.mark.parametrize(
    "corners",
    [
        [[0, 0], [1, 0]],
        [[0, 0], [0, 1], [1, 0]],
        [[0, 0], [2, 0], [1, 0.1], [1, 2]],
        [[0, 0], [1, 0], [2, 0], [1, 1]],
        [[0, 0], [1, 0], [1, 0], [0, 1]],
        [[0, 0], [1, 0], [float("nan"), 1]],
        [[np.cos(a), np.sin(a)] for a in 4 * np.pi / 5 * np.arange(5)],
    ],
    ids=["two corners", "clockwise", "dented", "straight corner", "repeated", "not finite", "star"],
)
def test_outlines_that_are_not_convex_and_counter_clockwise_are_refused(corners):
    with pytest.raises(ShapeError):
        convex_outline(corners)


@pytest.mark.parametrize("seed", range(10))
def test_the_distance_of_sides_is_the_least_of_all_their_points(seed):
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(12, 2)) * rng.uniform(0.05, 0.4, 2)
    outline = points[ConvexHull(points).vertices]
    parts = np.linspace(0.0, 1.0, 401)[:, None]
    one, other = outline[:2], outline[2:4] if len(outline) > 3 else outline[[2, 0]]
    along = [segment[0] + parts * (segment[1] - segment[0]) for segment in (one, other)]
    brute = float(np.linalg.norm(along[0][:, None] - along[1][None], axis=2).min())
    assert segment_distance(one, other) <= brute + 1e-12
    assert segment_distance(one, other) == pytest.approx(brute, abs=2e-3)


def test_a_corner_that_is_given_twice_changes_nothing():
    square, other = np.array([[0, 0], [2, 0], [2, 2], [0, 2.0]]), np.array([[1, 1], [3, 1], [3, 3], [1, 3.0]])
    twice = np.vstack([other[:1], other])
    assert overlap(square, twice) == pytest.approx(overlap(square, other))
    assert area(overlap(twice, square)) == pytest.approx(1.0)
