"""Solids: where they are, checked against the hull of their vertices."""

import numpy as np
import pytest
from scipy.spatial import Delaunay

from planners.contract.shapes import Box, Cylinder, Prism
from planners.scene.solid import solid_of

HEXAGON = tuple((0.2 * np.cos(k * np.pi / 3), 0.2 * np.sin(k * np.pi / 3)) for k in range(6))
SHAPES = [
    Box(type="box", size=(0.4, 0.3, 0.05)),
    Prism(type="prism", outline=HEXAGON, height=0.1),
    Prism(type="prism", outline=((0.1, 0.1), (0.4, 0.1), (0.2, 0.5)), height=0.04),
    Cylinder(type="cylinder", radius=0.15, height=0.2),
]


@pytest.mark.parametrize("shape", SHAPES)
def test_depth_is_positive_exactly_inside(shape):
    solid = solid_of(shape)
    corners = np.vstack([face.corners for face in solid.flat_faces()])
    points = np.random.default_rng(0).uniform(-0.5, 0.5, (500, 3)) * [1, 1, 0.3]
    inside = Delaunay(corners).find_simplex(points) >= 0
    assert 0 < inside.sum() < 500
    assert [solid.depth(point) > 0 for point in points] == inside.tolist()


@pytest.mark.parametrize("shape", SHAPES)
def test_the_corners_of_a_face_turn_about_its_outward_normal(shape):
    for face in solid_of(shape).flat_faces():
        a, b, c = face.corners[:3]
        normal = np.cross(b - a, c - b)
        assert normal / np.linalg.norm(normal) == pytest.approx(face.normal)
        assert (face.corners - a) @ face.normal == pytest.approx(0)


@pytest.mark.parametrize("shape", SHAPES)
def test_the_convex_drawing_contains_the_solid_closely(shape):
    solid = solid_of(shape)
    corners = np.vstack([face.corners for face in solid.flat_faces()])
    for direction in np.random.default_rng(1).normal(size=(200, 3)):
        reach = (solid.convex.vertices @ direction).max() + solid.convex.radius * np.linalg.norm(direction)
        true_reach = (corners @ direction).max()
        assert true_reach - 1e-12 <= reach <= true_reach + 0.01 * 0.2 * np.linalg.norm(direction)


def test_a_cylinder_rests_on_its_ends_only():
    assert len(solid_of(SHAPES[3]).flat_faces()) == 2


def test_a_box_rests_on_any_of_its_six_faces():
    normals = np.array([face.normal for face in solid_of(SHAPES[0]).flat_faces()])
    assert sorted(map(tuple, normals.round(12) + 0.0)) == sorted(
        tuple(sign * axis + 0.0) for axis in np.eye(3) for sign in (1.0, -1.0)
    )
