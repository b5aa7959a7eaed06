"""Convex parts leave nothing of a solid uncovered, and reach beyond it no farther than they say."""

import numpy as np
import pytest
import trimesh
from scipy.spatial import ConvexHull, Delaunay

from planners.geometry.convex_cover import CoverSettings, cover
from tests.geometry.mesh_shapes import angle, in_angle, ring, ring_depth
from tests.support.samples import among


def covered(found, points, slack=1e-9):
    """Whether (n, 3) points are in any part."""
    inside = np.zeros(len(points), dtype=bool)
    for part in found.parts:
        planes = ConvexHull(part).equations
        inside |= (points @ planes[:, :3].T + planes[:, 3]).max(axis=1) <= slack
    return inside


def cover_of(mesh, **settings):
    return cover(np.array(mesh.vertices), np.array(mesh.faces), CoverSettings(**settings))


def test_a_convex_mesh_is_its_own_only_part():
    for mesh in (trimesh.creation.box((0.1, 0.2, 0.3)), trimesh.creation.icosphere(3, 0.05)):
        found = cover_of(mesh)
        (part,) = found.parts
        assert len(part) == len(mesh.vertices)
        assert found.excess <= 1e-12


def test_an_angle_is_cut_into_two_boxes_exactly():
    mesh = angle()
    found = cover_of(mesh)
    assert len(found.parts) == 2
    assert found.excess <= 1e-12
    assert sum(ConvexHull(part).volume for part in found.parts) == pytest.approx(mesh.volume, rel=1e-9)
    points = np.random.default_rng(1).uniform([-0.02] * 3, [0.12, 0.1, 0.07], (20_000, 3))
    assert (covered(found, points, 0.0) == in_angle(points)).all()


@pytest.mark.parametrize("most_parts", among([1, 3, 32], [3]))
def test_nothing_of_a_solid_is_left_uncovered(most_parts):
    bowl = trimesh.creation.revolve(
        [[0, 0], [0.04, 0], [0.05, 0.06], [0.047, 0.06], [0.037, 0.003], [0, 0.003]], sections=24
    )
    for mesh in (angle(), ring(), bowl, trimesh.creation.annulus(0.02, 0.03, 0.1)):
        found = cover_of(mesh, most_parts=most_parts)
        assert len(found.parts) <= most_parts
        points, _ = trimesh.sample.sample_surface(mesh, 4000, seed=0)
        assert covered(found, np.vstack([mesh.vertices, points]), 1e-9).all()


@pytest.mark.slow
def test_no_inner_point_of_a_ring_is_left_uncovered():
    found = cover_of(ring())
    points = np.random.default_rng(2).uniform([-0.066, -0.066, -0.016], [0.066, 0.066, 0.016], (20_000, 3))
    assert covered(found, points[ring_depth(points) > 5e-4]).all()


@pytest.mark.slow
def test_parts_reach_no_farther_beyond_a_ring_than_they_say():
    found = cover_of(ring())
    assert 0 < found.excess <= 0.01 * np.linalg.norm([0.13, 0.13, 0.03]) + 5e-4
    points = np.random.default_rng(3).uniform([-0.066, -0.066, -0.016], [0.066, 0.066, 0.016], (40_000, 3))
    assert (-ring_depth(points[covered(found, points)])).max() <= found.excess + 5e-4


@pytest.mark.slow
def test_more_parts_follow_a_solid_more_closely():
    excess = [cover_of(ring(), most_parts=most).excess for most in (1, 4, 32)]
    assert excess[0] > excess[1] > excess[2]
    # One part is the hull, which fills the hole.
    assert excess[0] == pytest.approx(0.035, abs=2e-3)


@pytest.mark.slow
def test_the_same_mesh_gives_the_same_parts():
    one, other = cover_of(ring()), cover_of(ring())
    assert all((a == b).all() for a, b in zip(one.parts, other.parts, strict=True))


def test_hulls_of_parts_are_what_another_library_takes_them_for():
    mesh = trimesh.creation.annulus(0.02, 0.03, 0.1)
    found = cover_of(mesh)
    points = np.random.default_rng(4).uniform([-0.03, -0.03, -0.05], [0.03, 0.03, 0.05], (2000, 3))
    inside = np.any([Delaunay(part).find_simplex(points) >= 0 for part in found.parts], axis=0)
    assert (inside == covered(found, points, 0.0)).mean() > 0.999
