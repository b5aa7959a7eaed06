"""Where a lip seals: on what is whole under all of it."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from planners.certify.geometry.cover import SealingDisc
from planners.geometry.pose import Array
from tests.support.pierced_plate import pierced_plate

RADIUS = 0.018
DISC = SealingDisc(RADIUS, give=1e-3, seam=1e-5)
SIZE = np.array([0.1, 0.1, 0.02])
ROUNDING = 1e-4
"""How much wider a polygon is than its circle, and a hole than what seams leave of it [m]."""


def pierced(low: Array, high: Array) -> Array:
    """The plate's triangles, its top at z = 0."""
    vertices, faces = pierced_plate(SIZE, low, high)
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    assert mesh.is_watertight
    assert mesh.volume == pytest.approx(SIZE.prod() - SIZE[2] * np.prod(high - low))
    return vertices[faces] - [0.0, 0.0, SIZE[2] / 2]


def block(low: list[float], high: list[float]) -> Array:
    mesh = trimesh.creation.box(bounds=[low, high])
    return np.array(mesh.triangles, dtype=float)


@pytest.mark.parametrize("seed", range(60))
def test_a_disc_seals_beside_a_hole_and_nowhere_over_it(seed: int) -> None:
    rng = np.random.default_rng(seed)
    corner, size = rng.uniform(-0.03, 0.03, 2), rng.uniform(0.0002, 0.01, 2)
    low, high = corner - size / 2, corner + size / 2
    nearest = float(np.linalg.norm(np.clip([0.0, 0.0], low, high)))
    gap = DISC.gap(pierced(low, high))
    if nearest > RADIUS + ROUNDING:
        assert gap is None
    elif nearest < RADIUS - ROUNDING:
        assert gap is not None
        assert np.all((gap > low) & (gap < high))


def test_both_happen_among_these_holes() -> None:
    found = []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        corner, size = rng.uniform(-0.03, 0.03, 2), rng.uniform(0.0002, 0.01, 2)
        found.append(DISC.gap(pierced(corner - size / 2, corner + size / 2)) is None)
    assert 10 < sum(found) < 50


def test_a_disc_seals_up_to_the_border_and_not_beyond() -> None:
    for aside, seals in ((0.05 - RADIUS - ROUNDING, True), (0.05 - RADIUS + ROUNDING, False)):
        triangles = block([-0.05, -0.05, -0.02], [0.05, 0.05, 0.0]) - [aside, 0.0, 0.0]
        assert (DISC.gap(triangles) is None) == seals


@pytest.mark.parametrize(("height", "seals"), [(0.0009, True), (0.0011, False), (-0.0009, True), (-0.0011, False)])
def test_a_step_under_it_is_no_higher_than_it_gives(height: float, seals: bool) -> None:
    step = np.vstack(
        [block([-0.05, -0.05, -0.02], [0.004, 0.05, 0.0]), block([0.004, -0.05, -0.02], [0.05, 0.05, height])]
    )
    assert (DISC.gap(step) is None) == seals


@pytest.mark.parametrize(("lift", "seals"), [(0.9, True), (1.1, False)])
def test_a_slope_rises_under_it_no_higher_than_it_gives(lift: float, seals: bool) -> None:
    """It rises right up to the polygon's corner; a millimetre is 3 degrees there."""
    triangles = block([-0.05, -0.05, -0.02], [0.05, 0.05, 0.0])
    triangles[..., 2] += lift * DISC.give / DISC.outer_radius * triangles[..., 0]
    assert (DISC.gap(triangles) is None) == seals


def test_what_covers_one_place_twice_does_not_cover_another() -> None:
    """A second body under half of the lip has as much of a surface as the hole lacks."""
    triangles = pierced(np.array([-0.012, -0.003]), np.array([-0.006, 0.003]))
    twice = np.vstack([triangles, block([0.0, -0.04, -0.015], [0.04, 0.04, 0.0])])
    assert DISC.gap(twice) is not None
    assert DISC.gap(np.vstack([triangles, block([-0.02, -0.01, -0.015], [0.0, 0.01, 0.0])])) is None


def test_it_does_not_seal_on_the_inside_of_a_surface() -> None:
    triangles = block([-0.05, -0.05, -0.02], [0.05, 0.05, 0.0])
    assert DISC.gap(triangles) is None
    assert DISC.gap(triangles[:, ::-1]) is not None


@pytest.mark.parametrize("subdivisions", [1, 4])
def test_it_does_not_matter_how_finely_a_surface_is_divided(subdivisions: int) -> None:
    mesh = trimesh.creation.box(bounds=[[-0.05, -0.04, -0.02], [0.05, 0.06, 0.0]])
    for _ in range(subdivisions):
        mesh = mesh.subdivide()
    triangles = np.asarray(mesh.triangles, dtype=float)
    assert DISC.gap(triangles) is None
    # One triangle that lies under the lip is missing.
    middles = triangles.mean(axis=1)
    on_top = np.flatnonzero(middles[:, 2] > -1e-9)
    missing = on_top[np.argmin(np.linalg.norm(middles[on_top, :2], axis=1))]
    assert DISC.gap(np.delete(triangles, missing, axis=0)) is not None


def test_a_ball_is_sealed_on_where_it_falls_away_by_no_more_than_the_lip_gives() -> None:
    for radius, seals in ((0.25, True), (0.13, False)):
        ball = trimesh.creation.icosphere(subdivisions=5, radius=radius)
        top = np.asarray(ball.triangles, dtype=float) - [0.0, 0.0, ball.vertices[:, 2].max()]
        assert (DISC.gap(top) is None) == seals
