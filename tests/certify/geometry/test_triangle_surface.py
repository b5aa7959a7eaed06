"""Distances from a surface of triangles, by trimesh's word on each triangle alone."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from planners.certify.geometry.triangle_surface import TriangleSurface
from planners.geometry.pose import Array

RNG = np.random.default_rng(11)
RING, TUBE = 0.05, 0.02
CHORDS = 0.0015
"""How far chords lie within the true torus, at most [m]."""
TORUS = trimesh.creation.torus(RING, TUBE, 24, 12)
SURFACE = TriangleSurface(np.asarray(TORUS.triangles, dtype=float))
AROUND = RNG.uniform(-0.09, 0.09, (30, 3))
ON_CORNERS = np.asarray(TORUS.vertices[::40], dtype=float)


def to_each_triangle(point: Array) -> Array:
    """The distances by trimesh."""
    nearest = trimesh.triangles.closest_point(SURFACE.triangles, np.tile(point, (len(SURFACE.triangles), 1)))
    return np.linalg.norm(nearest - point, axis=1)


@pytest.mark.parametrize("point", [*AROUND, *ON_CORNERS])
def test_the_distance_is_that_of_the_nearest_triangle_and_negative_inside(point: Array) -> None:
    distance, normal = SURFACE.signed_distance(point)
    assert abs(distance) == pytest.approx(to_each_triangle(point).min(), abs=1e-9)
    from_ring = np.hypot(np.hypot(*point[:2]) - RING, point[2])
    if from_ring > TUBE or from_ring < TUBE - CHORDS:
        assert (distance < 0.0) == (from_ring < TUBE)
    assert np.linalg.norm(normal) == pytest.approx(1.0)


@pytest.mark.parametrize("point", AROUND)
@pytest.mark.parametrize("reach", [0.002, 0.02])
def test_normals_near_a_point_are_those_of_the_triangles_within_reach(point: Array, reach: float) -> None:
    within = to_each_triangle(point) <= reach
    assert SURFACE.normals_near(point, reach) == pytest.approx(np.asarray(TORUS.face_normals)[within])


@pytest.mark.parametrize("reach", [0.002, 0.02])
@pytest.mark.parametrize("points", [AROUND, ON_CORNERS])
def test_faces_near_many_points_are_those_near_each_of_them(points: Array, reach: float) -> None:
    normals, near = SURFACE.faces_near(points, reach)
    assert near.any(axis=0).all()
    for point, mask in zip(points, near, strict=True):
        assert np.array_equal(normals[mask], SURFACE.normals_near(point, reach))


def test_a_step_off_the_surface_is_as_far_as_it_is_long() -> None:
    centres = SURFACE.triangles.mean(axis=1)
    for centre, normal in zip(centres[::20], SURFACE.normals[::20], strict=True):
        for step in (-1e-3, 1e-3):
            assert SURFACE.signed_distance(centre + step * normal)[0] == pytest.approx(step, abs=1e-9)
