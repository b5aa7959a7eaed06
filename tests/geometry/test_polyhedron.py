"""Which elements of a polyhedron bound which, against the point sets they are; its surface against scipy."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from planners.geometry.polygon import ShapeError, rectangle
from planners.geometry.polyhedron import ConvexPrism, ElementKind, Polyhedron
from tests.support.polyhedra import face_normal

HEXAGON = [[0.2 * np.cos(a), 0.2 * np.sin(a)] for a in np.pi / 3 * np.arange(6)]
PRISMS = [ConvexPrism.from_outline(rectangle(0.3, 0.4), 0.04), ConvexPrism.from_outline(HEXAGON, 0.03)]
DIMENSION = {ElementKind.VERTEX: 0, ElementKind.EDGE: 1, ElementKind.FACE: 2}


@pytest.mark.parametrize("prism", PRISMS)
def test_an_element_bounds_another_when_its_points_are_some_of_the_others(prism):
    body = prism.polyhedron
    for element, boundary in body.boundary.items():
        points = set(body.vertex_indices(element))
        expected = {other for other in body.boundary if set(body.vertex_indices(other)) < points}
        assert boundary == expected
        assert all(DIMENSION[other.kind] < DIMENSION[element.kind] for other in boundary)


@pytest.mark.parametrize("prism", PRISMS)
def test_faces_are_those_of_the_convex_hull_and_their_normals_point_outward(prism):
    body = prism.polyhedron
    planes = np.array(
        [[*face_normal(body, k), -face_normal(body, k) @ body.vertices[f[0]]] for k, f in enumerate(body.faces)]
    )
    hull = np.unique(np.round(ConvexHull(body.vertices).equations, 9), axis=0) + 0.0
    assert np.unique(np.round(planes, 9), axis=0) + 0.0 == pytest.approx(hull)


def test_bottom_elements_carry_the_numbers_of_the_outline():
    prism = PRISMS[1]
    body = prism.polyhedron
    assert set(body.vertex_indices(prism.bottom)) == set(range(6))
    assert prism.bottom_vertices[:, :2] == pytest.approx(np.array(HEXAGON))
    assert np.all(prism.bottom_vertices[:, 2] == -0.015)
    assert face_normal(body, prism.bottom.index) == pytest.approx([0, 0, -1])
    assert face_normal(body, 1) == pytest.approx([0, 0, 1])
    assert [body.edges[k] for k in range(6)] == [(k, (k + 1) % 6) for k in range(6)]
    assert all({k, (k + 1) % 6} <= set(body.faces[2 + k]) for k in range(6))


def test_a_box_has_its_frame_at_its_centre():
    vertices = ConvexPrism.from_outline(rectangle(0.3, 0.4), 0.04).polyhedron.vertices
    assert vertices.min(axis=0) == pytest.approx([-0.15, -0.2, -0.02])
    assert vertices.max(axis=0) == pytest.approx([0.15, 0.2, 0.02])


def test_an_open_surface_is_refused():
    body = PRISMS[0].polyhedron
    with pytest.raises(ShapeError):
        Polyhedron(body.vertices, body.faces[:-1], body.edges)


@pytest.mark.parametrize("height", [0.0, -0.1, float("nan")])
def test_a_prism_without_height_is_refused(height):
    with pytest.raises(ShapeError):
        ConvexPrism.from_outline(HEXAGON, height)
