"""Where lines are inside solids, by brute force: by points along them."""

from __future__ import annotations

import numpy as np
import pytest

from planners.certify.geometry.body_shape import BodyShape, box, convex_part
from planners.certify.geometry.triangle_surface import stretches_inside
from planners.geometry.pose import Array, rotation_from_vector

SEAM = 1e-5
PLACES = np.linspace(-0.5, 0.5, 2001)


def of_boxes(rng: np.random.Generator, number: int) -> BodyShape:
    parts = []
    for _ in range(number):
        corners = box(rng.uniform(0.02, 0.15, 3)).vertices @ rotation_from_vector(rng.normal(size=3)).T
        parts.append(convex_part(corners + rng.uniform(-0.1, 0.1, 3)))
    return BodyShape(np.vstack([part.vertices for part in parts]), tuple(parts))


def inside(shape: BodyShape, points: Array) -> Array:
    each = [np.all(points @ part.planes[:, :3].T + part.planes[:, 3] <= 0.0, axis=1) for part in shape.parts]
    return np.any(each, axis=0)


@pytest.mark.parametrize("seed", range(20))
def test_a_line_is_inside_where_its_points_are_however_parts_overlap(seed: int) -> None:
    rng = np.random.default_rng(seed)
    shape, point, direction = of_boxes(rng, 8), rng.uniform(-0.05, 0.05, 3), rng.normal(size=3)
    direction /= np.linalg.norm(direction)
    stretches = stretches_inside(shape.triangles, point, direction, SEAM)
    assert np.all(np.diff(stretches.ravel()) > 0.0)
    # Next to an end rounding decides.
    clear = np.abs(PLACES[:, None] - stretches.ravel()).min(axis=1, initial=1.0) > 1e-6
    within = np.any((PLACES[:, None] > stretches[:, 0]) & (PLACES[:, None] < stretches[:, 1]), axis=1)
    assert np.array_equal(within[clear], inside(shape, point + PLACES[:, None] * direction)[clear])


@pytest.mark.parametrize("cut", [0.0, 0.007, -0.02])
@pytest.mark.parametrize("gap", [-1e-3, 0.0, 0.9 * SEAM])
def test_a_body_in_two_parts_that_touch_is_as_thick_as_the_whole(cut: float, gap: float) -> None:
    halves = [box(np.array([0.03 + cut - gap / 2, 0.02, 0.1])), box(np.array([0.03 - cut - gap / 2, 0.02, 0.1]))]
    centres = np.array([[-0.015 + cut / 2 - gap / 4, 0, 0], [0.015 + cut / 2 + gap / 4, 0, 0]])
    parts = tuple(convex_part(half.vertices + centre) for half, centre in zip(halves, centres, strict=True))
    triangles = BodyShape(halves[0].vertices, parts).triangles
    stretches = stretches_inside(triangles, np.zeros(3), np.array([1.0, 0, 0]), SEAM)
    assert stretches == pytest.approx(np.array([[-0.03, 0.03]]), abs=1e-9)


def test_a_gap_that_is_wider_divides() -> None:
    corners = box(np.array([0.02, 0.02, 0.1])).vertices
    parts = tuple(convex_part(np.add(corners, [x, 0, 0])) for x in (-0.0101, 0.0101))
    triangles = BodyShape(parts[0].vertices, parts).triangles
    stretches = stretches_inside(triangles, np.zeros(3), np.array([1.0, 0, 0]), SEAM)
    assert stretches == pytest.approx(np.array([[-0.0201, -0.0001], [0.0001, 0.0201]]), abs=1e-9)


@pytest.mark.parametrize("direction", np.vstack([np.eye(3), -np.eye(3)]))
@pytest.mark.parametrize("aside", [0.0, 0.01])
def test_a_line_along_the_edges_of_triangles_misses_nothing(direction: Array, aside: float) -> None:
    shape = box(np.array([0.06, 0.04, 0.08]))
    point = aside * np.roll(np.abs(direction), 1)
    half = float(np.abs(direction) @ [0.03, 0.02, 0.04])
    stretches = stretches_inside(shape.triangles, point, direction, SEAM)
    assert stretches == pytest.approx(np.array([[-half, half]]), abs=1e-9)


def test_a_line_beside_a_body_has_no_stretch() -> None:
    triangles = box(np.array([0.06, 0.04, 0.08])).triangles
    assert len(stretches_inside(triangles, np.array([0.0, 0.021, 0.0]), np.array([1.0, 0, 0]), SEAM)) == 0
