"""Grips by their laws: antipodal, pads on the plate, even and symmetric."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from planners.errors import LiftwrightError
from planners.geometry.polygon import depth_inside, rectangle
from planners.geometry.polyhedron import ConvexPrism
from planners.manipulation.holds.grips import (
    CupFootprint,
    GripSampling,
    Jaw,
    generate_grips,
    given_grips,
    least_opening,
)
from planners.scene.lift_placements import GivenGrip

REACH = 0.5
"""Of the papers' arms [m]."""
JAW = Jaw(width_max=0.085, pad_size=(0.022, 0.0375))
ACRYLIC = ConvexPrism.from_outline(rectangle(0.3, 0.3), 0.04)
PLYWOOD = ConvexPrism.from_outline(rectangle(0.4, 0.5), 0.044)
SAMPLING = GripSampling()


def random_plate(seed: int) -> ConvexPrism:
    points = np.random.default_rng(seed).normal(scale=0.2, size=(7, 2))
    return ConvexPrism.from_outline(points[ConvexHull(points).vertices], 0.03)


PLATES = [
    ACRYLIC,
    PLYWOOD,
    ConvexPrism.from_outline([[0, 0], [0.5, 0.05], [0.1, 0.4]], 0.02),
    ConvexPrism.from_outline([[0.2 * math.cos(a), 0.2 * math.sin(a)] for a in math.pi / 3 * np.arange(6)], 0.05),
    *(random_plate(seed) for seed in range(6)),
]


@pytest.fixture(params=range(len(PLATES)))
def plate(request) -> ConvexPrism:
    return PLATES[request.param]


def test_the_papers_plates_have_the_papers_numbers_of_grips():
    assert len(generate_grips(ACRYLIC, JAW, REACH)) == 30
    assert len(generate_grips(PLYWOOD, JAW, REACH)) == 36


@pytest.mark.parametrize("room", [0.012, 0.02, 0.1])
def test_a_plate_goes_no_deeper_into_a_gripper_than_to_its_palm(room):
    grips = generate_grips(ACRYLIC, replace(JAW, room=room), REACH)
    depths = depth_inside(ACRYLIC.outline, np.array([grip.T_plate_tcp[0, :2, 3] for grip in grips]))
    assert depths.max() <= room - SAMPLING.palm_clearance + 1e-9
    assert depths.max() <= SAMPLING.depth + 1e-9
    assert len(grips) == len(generate_grips(ACRYLIC, JAW, REACH))


def test_fingers_are_antipodal_on_top_and_bottom(plate):
    grips = generate_grips(plate, JAW, REACH)
    assert grips
    for number, grip in enumerate(grips):
        assert grip.index == number
        assert grip.width == pytest.approx(plate.height)
        for points, normals in zip(grip.points, grip.normals, strict=True):
            assert normals[0] == pytest.approx(-normals[1])
            assert points[1] - points[0] == pytest.approx(plate.height * normals[0])
            assert sorted(points[:, 2]) == pytest.approx([-plate.height / 2, plate.height / 2])


def test_finger_0_is_on_the_tcps_negative_y_and_both_at_the_pads_centres(plate):
    for grip in generate_grips(plate, JAW, REACH):
        for T, points, normals in zip(grip.T_plate_tcp, grip.points, grip.normals, strict=True):
            assert T[:3, :3].T @ T[:3, :3] == pytest.approx(np.eye(3), abs=1e-12)
            assert np.linalg.det(T[:3, :3]) == pytest.approx(1.0)
            in_tcp = (points - T[:3, 3]) @ T[:3, :3]
            half = 0.5 * plate.height
            assert in_tcp == pytest.approx(np.array([[0, -half, 0], [0, half, 0]]), abs=1e-12)
            assert normals @ T[:3, :3] == pytest.approx(np.array([[0, 1, 0], [0, -1, 0]]), abs=1e-12)


def test_the_flips_share_the_approach_and_swap_the_fingers(plate):
    for grip in generate_grips(plate, JAW, REACH):
        one, other = grip.T_plate_tcp
        assert one[:3, 2] == pytest.approx(other[:3, 2])
        assert one[:3, 3] == pytest.approx(other[:3, 3])
        assert one[:3, 1] == pytest.approx(-other[:3, 1])
        assert grip.points[0] == pytest.approx(grip.points[1][::-1])
        assert grip.normals[0] == pytest.approx(grip.normals[1][::-1])


def test_the_hand_comes_from_outside_square_to_a_side(plate):
    for grip in generate_grips(plate, JAW, REACH):
        rim = (grip.T_plate_tcp[0, :3, 3] - SAMPLING.depth * grip.approach)[None, :2]
        assert depth_inside(plate.outline, rim)[0] == pytest.approx(0.0, abs=1e-9)
        # Square to the side: no direction leads deeper as fast as the approach.
        assert depth_inside(plate.outline, rim + 1e-4 * grip.approach[:2])[0] == pytest.approx(1e-4, rel=1e-6)


def test_pads_lie_on_the_plate_across_their_whole_width(plate):
    across, along = JAW.pad_size
    for grip in generate_grips(plate, JAW, REACH):
        T = grip.T_plate_tcp[0]
        depths = (SAMPLING.rim_tolerance - SAMPLING.depth, 0.5 * along)
        corners = [T[:2, 3] + w * T[:2, 0] + d * T[:2, 2] for w in (-across / 2, across / 2) for d in depths]
        assert depth_inside(plate.outline, np.array(corners)).min() > -1e-9


@pytest.mark.parametrize("size", [[0.3, 0.3, 0.04], [0.4, 0.5, 0.044], [0.9, 0.2, 0.03], [0.31, 0.47, 0.03]])
@pytest.mark.parametrize("axis", [0, 1])
def test_the_grips_of_a_rectangle_are_symmetric(size, axis):
    places = np.array(
        [
            grip.T_plate_tcp[0][:2, [2, 3]].ravel()
            for grip in generate_grips(ConvexPrism.from_outline(rectangle(*size[:2]), size[2]), JAW, REACH)
        ]
    )
    mirror = np.ones(4)
    mirror[[2 * axis, 2 * axis + 1]] = -1.0
    assert {tuple(row) for row in np.round(places, 9) + 0.0} == {
        tuple(row) for row in np.round(places * mirror, 9) + 0.0
    }


def test_neighbouring_grips_on_a_side_are_equally_far_apart(plate):
    grips = generate_grips(plate, JAW, REACH)
    gaps = [
        np.linalg.norm(a.T_plate_tcp[0, :3, 3] - b.T_plate_tcp[0, :3, 3])
        for a, b in pairwise(grips)
        if np.allclose(a.approach, b.approach)
    ]
    assert gaps == pytest.approx([gaps[0]] * len(gaps))


def test_no_grip_on_a_plate_thicker_than_the_opening():
    assert generate_grips(ConvexPrism.from_outline(rectangle(0.3, 0.3), 0.0811), JAW, REACH) == ()
    assert generate_grips(ConvexPrism.from_outline(rectangle(0.3, 0.3), 0.0809), JAW, REACH) != ()


@pytest.mark.parametrize("centre", [(0.11, 0.02), (0.09, 0.003), (0.12, -0.07), (-0.03, 0.105), (0.0, -0.095)])
def test_grips_whose_pad_meets_the_cup_are_left_out_and_no_others(centre):
    cup = CupFootprint(centre, 0.0275)
    kept = {tuple(grip.T_plate_tcp[0].ravel()) for grip in generate_grips(ACRYLIC, JAW, REACH, cup=cup)}
    every = generate_grips(ACRYLIC, JAW, REACH)
    assert 0 < len(every) - len(kept) < 6
    across, along = (np.linspace(-0.5, 0.5, 200) * size for size in JAW.pad_size)
    for grip in every:
        T = grip.T_plate_tcp[0]
        pad = T[:2, 3] + across[:, None, None] * T[:2, 0] + along[None, :, None] * T[:2, 2]
        distance = np.linalg.norm(pad - np.array(cup.centre), axis=2).min()
        limit = cup.radius + SAMPLING.cup_clearance
        assert abs(distance - limit) > 1e-4, "the sampled distance must decide"
        assert (tuple(T.ravel()) in kept) == (distance > limit)


def test_generated_grips_that_a_task_gives_itself_are_the_same_grips(plate):
    grips = generate_grips(plate, JAW, REACH)
    given = [GivenGrip(grip.T_plate_tcp[0, :3, 3], grip.approach) for grip in grips]
    for again, made in zip(given_grips(given, plate), grips, strict=True):
        assert again.index == made.index
        assert again.width == made.width
        for name in ("T_plate_tcp", "points", "normals"):
            assert getattr(again, name) == pytest.approx(getattr(made, name), abs=1e-12)


def test_a_sampling_that_means_nothing_is_refused():
    with pytest.raises(LiftwrightError):
        GripSampling(count=0)


def test_a_plate_thicker_than_the_opening_may_still_be_held_across_a_sharp_corner():
    """An equilateral triangle's corner of 60 degrees is held with friction above tan 30 degrees, at any width."""
    corners = [(0.4 * math.cos(a), 0.4 * math.sin(a)) for a in (0.0, 2.0 * math.pi / 3.0, 4.0 * math.pi / 3.0)]
    triangle = ConvexPrism.from_outline(corners, 0.2)
    assert least_opening(triangle, 0.5) == pytest.approx(0.2)
    assert least_opening(triangle, 0.6) == pytest.approx(0.0)


def test_a_box_is_held_across_its_least_side():
    assert least_opening(ConvexPrism.from_outline(rectangle(0.3, 0.06), 0.1), 0.5) == pytest.approx(0.06)
    assert least_opening(ConvexPrism.from_outline(rectangle(0.3, 0.2), 0.1), 0.5) == pytest.approx(0.1)
