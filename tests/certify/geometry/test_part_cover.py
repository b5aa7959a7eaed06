"""The convex parts of a mesh contain its surface, corners and all between them."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from planners.certify.geometry.body_shape import BodyShape, mesh
from planners.certify.geometry.cover import beyond_parts
from planners.geometry.convex_cover import cover
from planners.geometry.pose import Array

GIVE = 5e-4
BOX = trimesh.creation.box([0.2, 0.1, 0.05])


def slab(begin: float, end: float) -> Array:
    return np.array([[x, y, z] for x in (begin, end) for y in (-0.05, 0.05) for z in (-0.025, 0.025)])


def boxed(*slabs: tuple[float, float]) -> BodyShape:
    parts = [slab(*ends) for ends in slabs]
    return mesh(np.asarray(BOX.vertices), np.asarray(BOX.faces), parts)


@pytest.mark.parametrize("seed", range(20))
def test_parts_that_leave_a_gap_out_are_found_wherever_it_is(seed: int) -> None:
    rng = np.random.default_rng(seed)
    begin, width = rng.uniform(-0.09, 0.05), rng.uniform(0.0011, 0.04)
    height, point = beyond_parts(boxed((-0.1, begin), (begin + width, 0.1)), GIVE)
    assert height > GIVE
    assert begin + GIVE < point[0] < begin + width - GIVE
    assert np.abs(point / [0.1, 0.05, 0.025]).max() == pytest.approx(1.0)


@pytest.mark.parametrize("width", [-0.01, 0.0, 0.0009])
def test_parts_that_touch_overlap_or_nearly_do_leave_nothing(width: float) -> None:
    parts = boxed((-0.1, -0.03), (-0.03 + width, 0.02), (0.02 + width, 0.1))
    assert beyond_parts(parts, GIVE)[0] <= GIVE


@pytest.mark.parametrize("out", [0.0004, 0.0006, 0.02])
def test_a_corner_outside_is_as_far_out_as_it_is(out: float) -> None:
    assert beyond_parts(boxed((-0.1, 0.1 - out)), GIVE)[0] == pytest.approx(out)


@pytest.mark.slow
def test_the_parts_of_a_ring_contain_it_and_none_can_be_left_out() -> None:
    ring = trimesh.creation.torus(0.05, 0.015, major_sections=48, minor_sections=24)
    corners, faces = np.asarray(ring.vertices), np.asarray(ring.faces)
    parts = cover(corners, faces).parts
    assert len(parts) > 2
    assert beyond_parts(mesh(corners, faces, parts), GIVE)[0] <= GIVE
    for left_out in range(len(parts)):
        some = [part for k, part in enumerate(parts) if k != left_out]
        assert beyond_parts(mesh(corners, faces, some), GIVE)[0] > GIVE
