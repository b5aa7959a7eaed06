"""Wrenches and twists keep their power whichever frame and point they are written in."""

from __future__ import annotations

import numpy as np
import pytest

from planners.geometry.pose import rotation_from_vector, skew, transform
from planners.geometry.wrench import grasp_map, rotated, wrench_about


@pytest.fixture(params=range(5))
def rng(request) -> np.random.Generator:
    return np.random.default_rng(request.param)


def test_grasp_map_preserves_power(rng):
    T_object_contact = transform(rotation_from_vector(rng.standard_normal(3)), rng.standard_normal(3))
    wrench_contact, twist_object = rng.standard_normal((2, 6))
    v, w = twist_object[:3], twist_object[3:]
    R, p = T_object_contact[:3, :3], T_object_contact[:3, 3]
    twist_contact = np.concatenate([R.T @ (v + np.cross(w, p)), R.T @ w])
    assert wrench_contact @ twist_contact == pytest.approx(
        (grasp_map(T_object_contact) @ wrench_contact) @ twist_object
    )


def test_grasp_maps_compose_like_transforms(rng):
    T_a_b, T_b_c = (transform(rotation_from_vector(v), p) for v, p in rng.standard_normal((2, 2, 3)))
    assert grasp_map(T_a_b @ T_b_c) == pytest.approx(grasp_map(T_a_b) @ grasp_map(T_b_c))


def test_grasp_map_is_a_rotation_then_a_move_of_the_point(rng):
    T = transform(rotation_from_vector(rng.standard_normal(3)), rng.standard_normal(3))
    wrenches = rng.standard_normal((4, 6))
    moved = wrench_about(rotated(T[:3, :3], wrenches), T[:3, 3], np.zeros(3))
    assert moved == pytest.approx(wrenches @ grasp_map(T).T)


def test_a_pure_force_has_the_moment_of_its_lever(rng):
    force, lever = rng.standard_normal((2, 3))
    moved = wrench_about(np.concatenate([force, np.zeros(3)]), lever, np.zeros(3))
    assert moved[3:] == pytest.approx(skew(lever) @ force)
