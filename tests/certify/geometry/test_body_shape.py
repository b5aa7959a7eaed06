"""The mass properties of shapes, by coal's word."""

from __future__ import annotations

import coal
import numpy as np
import pytest

from planners.certify.geometry.body_shape import BodyShape, box, convex_part, prism


def test_the_inertia_of_a_convex_body_is_coals() -> None:
    rng = np.random.default_rng(3)
    for _ in range(10):
        part = convex_part(rng.normal(size=(12, 3)))
        points = coal.StdVec_Vec3s()
        for vertex in part.vertices:
            points.append(vertex)
        hull = coal.Convex.convexHull(points, True, None)
        centre, volume = hull.computeCOM(), hull.computeVolume()
        shift = float(centre @ centre) * np.eye(3) - np.outer(centre, centre)
        ours = BodyShape(part.vertices, (part,)).inertia(volume, np.zeros(3))
        assert ours == pytest.approx(hull.computeMomentofInertia(), rel=1e-6, abs=1e-9)
        about_centre = BodyShape(part.vertices, (part,)).inertia(volume, centre)
        assert about_centre == pytest.approx(ours - volume * shift, rel=1e-6, abs=1e-9)


def test_a_body_of_two_parts_has_the_inertia_of_the_whole() -> None:
    outline = np.array([[-0.2, -0.1], [0.2, -0.1], [0.2, 0.1], [-0.2, 0.1]])
    halves = [outline * [0.5, 1.0] + [shift, 0.0] for shift in (-0.1, 0.1)]
    parts = tuple(prism(half, 0.04).parts[0] for half in halves)
    point = np.array([0.03, -0.02, 0.01])
    whole = box(np.array([0.4, 0.2, 0.04]))
    assert BodyShape(whole.vertices, parts).inertia(3.0, point) == pytest.approx(whole.inertia(3.0, point))


def test_faces_near_many_points_are_those_near_each_of_them() -> None:
    rng = np.random.default_rng(5)
    beside = np.array([0.2, 0.0, 0.0])
    parts = tuple(convex_part(rng.normal(scale=0.05, size=(12, 3)) + shift) for shift in (np.zeros(3), beside))
    shape = BodyShape(np.vstack([part.vertices for part in parts]), parts)
    corners, middles = shape.vertices, shape.triangles.mean(axis=1)
    points = np.vstack([corners, middles, rng.uniform(-0.1, 0.3, (50, 3))])
    normals, near = shape.faces_near(points, 1e-3)
    assert near.any(axis=0).all()
    assert near[: len(corners) + len(middles)].any(axis=1).all()
    for point, mask in zip(points, near, strict=True):
        one_by_one = np.array(shape.normals_near(point, 1e-3)).reshape(-1, 3)
        assert np.array_equal(normals[mask], one_by_one)
