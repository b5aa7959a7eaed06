"""GJK against coal, against brute force on the Minkowski difference, and where shapes degenerate."""

from __future__ import annotations

import math

import coal
import numpy as np
import pytest
from scipy.optimize import nnls
from scipy.spatial import ConvexHull

from planners.collision.distance import distance
from planners.geometry.convex import ConvexShape, box, capsule, cylinder, prism
from planners.geometry.pose import Array, Transform, rotation_from_vector, transform
from tests.collision.synthetic_cell import sphere


def random_transform(rng: np.random.Generator, spread: float) -> Transform:
    return transform(rotation_from_vector(rng.normal(size=3)), spread * rng.normal(size=3))


def random_hull(rng: np.random.Generator, n: int, size: float) -> ConvexShape:
    return ConvexShape(size * rng.uniform(-1, 1, size=(n, 3)))


def minkowski_distance(a: Array, b: Array) -> float:
    """Distance of two hulls by brute force: the facet of all differences nearest the origin; 0 inside."""
    differences = (a[:, None, :] - b[None, :, :]).reshape(-1, 3)
    hull = ConvexHull(differences, qhull_options="QJ")
    if np.all(hull.equations[:, 3] <= 0):
        return 0.0
    least = math.inf
    # Heavy last row: the weights of the corners sum to one.
    weight = 1e4
    for facet in hull.simplices[hull.equations[:, 3] > -1e-9]:
        corners = differences[facet]
        weights, _ = nnls(np.vstack([corners.T, np.full(3, weight)]), [0.0, 0.0, 0.0, weight])
        least = min(least, float(np.linalg.norm(weights @ corners / weights.sum())))
    return least


def coal_distance(a: ConvexShape, T_a: Transform, b: ConvexShape, T_b: Transform) -> float:
    request = coal.DistanceRequest()
    request.gjk_tolerance = 1e-9
    result = coal.DistanceResult()
    poses = [coal.Transform3s(T[:3, :3], T[:3, 3]) for T in (T_a, T_b)]
    hulls = []
    for shape in (a, b):
        points = coal.StdVec_Vec3s()
        points.extend(list(shape.vertices))
        hulls.append(coal.ConvexBase.convexHull(points, True, "Qt"))
    return coal.distance(hulls[0], poses[0], hulls[1], poses[1], request, result) - a.radius - b.radius


@pytest.mark.parametrize("seed", range(60))
def test_distance_is_that_of_the_origin_from_the_minkowski_difference(seed):
    rng = np.random.default_rng(seed)
    a, b = (random_hull(rng, int(rng.integers(4, 14)), float(10 ** rng.uniform(-1.5, 0.5))) for _ in range(2))
    T_a, T_b = random_transform(rng, 0.5), random_transform(rng, 0.5)
    expected = minkowski_distance(a.placed(T_a).vertices, b.placed(T_b).vertices)
    assert max(distance(a, T_a, b, T_b), 0.0) == pytest.approx(expected, abs=1e-6)


def test_distance_agrees_with_coal_on_random_hulls():
    rng = np.random.default_rng(1)
    for _ in range(2000):
        a, b = (random_hull(rng, int(rng.integers(6, 60)), float(rng.uniform(0.02, 0.3))) for _ in range(2))
        T_a, T_b = random_transform(rng, 0.3), random_transform(rng, 0.3)
        expected = coal_distance(a, T_a, b, T_b)
        assert max(distance(a, T_a, b, T_b), 0.0) == pytest.approx(max(expected, 0.0), abs=2e-7)


def test_distance_is_symmetric_and_moves_with_the_world():
    rng = np.random.default_rng(2)
    for _ in range(200):
        a, b = random_hull(rng, 20, 0.2), random_hull(rng, 8, 0.4)
        T_a, T_b, T = (random_transform(rng, 0.5) for _ in range(3))
        d = distance(a, T_a, b, T_b)
        assert distance(b, T_b, a, T_a) == pytest.approx(d, abs=1e-9)
        assert distance(a, T @ T_a, b, T @ T_b) == pytest.approx(d, abs=1e-9)


@pytest.mark.parametrize("gap", [0.0, 1e-7, 1e-4, 0.01, 10.0])
@pytest.mark.parametrize("yaw", [0.0, 0.3, math.pi / 4, math.pi / 2])
def test_parallel_faces_are_apart_by_their_gap(gap, yaw):
    lower, upper = box([0.8, 1.83, 0.024]), box([0.3, 0.3, 0.04])
    T = transform(rotation_from_vector([0, 0, yaw]), [0.1, 0.2, 0.012 + 0.02 + gap])
    assert distance(lower, np.eye(4), upper, T) == pytest.approx(gap, abs=1e-9)


@pytest.mark.parametrize(
    ("a", "b", "position", "expected"),
    [
        pytest.param(sphere([0, 0, 0], 0.1), sphere([0, 0, 0], 0.2), [3, 4, 0], 4.7, id="two balls"),
        pytest.param(sphere([0, 0, 0], 0.0), sphere([0, 0, 0], 0.0), [0, 0, 0], 0.0, id="one point"),
        pytest.param(sphere([0, 0, 0], 0.1), sphere([0, 0, 0], 0.2), [0, 0, 0], -0.3, id="concentric balls"),
        pytest.param(
            capsule([0, 0, -1], [0, 0, 1], 0.1), capsule([-1, 0, 0], [1, 0, 0], 0.1), [0, 1, 0], 0.8, id="crossed rods"
        ),
        pytest.param(
            capsule([0, 0, -1], [0, 0, 1], 0.1),
            capsule([0, 0, -1], [0, 0, 1], 0.1),
            [1, 0, 0.5],
            0.8,
            id="parallel rods",
        ),
        pytest.param(
            capsule([0, 0, -1], [0, 0, 1], 0.0), capsule([0, 0, -1], [0, 0, 1], 0.0), [0, 0, 3], 1.0, id="rods in a row"
        ),
        pytest.param(capsule([0, 0, 0], [0, 0, 0], 0.1), box([1, 1, 1]), [1, 0, 0], 0.4, id="rod of no length"),
        pytest.param(box([1, 1, 1]), box([1, 1, 1]), [0, 0, 0], 0.0, id="identical boxes"),
        pytest.param(box([1, 1, 1]), box([1, 1, 1]), [1, 1, 1], 0.0, id="corner to corner"),
        pytest.param(box([1, 1, 1]), box([1, 1, 1]), [1, 1, 0], 0.0, id="edge to edge"),
        pytest.param(box([1, 1, 1]), box([1, 1, 1]), [2, 2, 2], math.sqrt(3), id="corners apart"),
        pytest.param(box([1, 1, 0]), box([1, 1, 0]), [0.2, 0.3, 0], 0.0, id="coplanar plates"),
        pytest.param(box([1, 1, 0]), box([1, 1, 0]), [1.25, 0, 0], 0.25, id="coplanar plates apart"),
        pytest.param(box([1e-6, 1e-6, 1e-6]), box([1e-6, 1e-6, 1e-6]), [0.5, 0, 0], 0.5 - 1e-6, id="specks"),
        pytest.param(box([1e-6, 1e-6, 1e-6]), box([100, 100, 100]), [51, 0, 0], 1 - 5e-7, id="speck and hall"),
        pytest.param(box([100, 100, 100]), box([100, 100, 100]), [1, 2, 3], 0.0, id="deep"),
        pytest.param(box([2, 2, 2]), box([0.1, 0.1, 0.1]), [0, 0, 0], 0.0, id="one inside the other"),
        pytest.param(box([1, 0, 0]), box([0, 0, 0]), [0, 0.5, 0], 0.5, id="needle and point, corners repeated"),
    ],
)
def test_distance_of_degenerate_shapes_is_the_one_by_hand(a, b, position, expected):
    T = transform(position=position)
    d = distance(a, np.eye(4), b, T)
    if expected > 0:
        assert d == pytest.approx(expected, abs=1e-9)
    else:
        assert d <= 1e-9


def test_a_cylinder_is_never_drawn_smaller_than_it_is():
    shape, probe = cylinder(0.0375, 0.0484), sphere([0, 0, 0], 0.0)
    for angle in np.linspace(0, 2 * math.pi, 500):
        rim = [0.0375 * math.cos(angle), 0.0375 * math.sin(angle), 0.0242]
        assert distance(probe, transform(position=rim), shape, np.eye(4)) <= 1e-9


def test_a_prism_is_its_outline_at_every_height():
    outline = [[0.1, 0.0], [0.0, 0.1], [-0.1, 0.0], [0.0, -0.1]]
    shape = prism(outline, 0.04)
    for x, y in outline:
        for z in (-0.02, 0.0, 0.02):
            assert distance(sphere([x, y, z], 0.0), np.eye(4), shape, np.eye(4)) <= 1e-12
            assert distance(sphere([2 * x, 2 * y, z], 0.0), np.eye(4), shape, np.eye(4)) == pytest.approx(0.1)
