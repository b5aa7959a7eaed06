"""Pushes by their laws: on the surface, inside the push cone, the stick clear of the plate, even and symmetric."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from planners.errors import LiftwrightError
from planners.geometry.polygon import rectangle
from planners.geometry.polyhedron import ConvexPrism
from planners.manipulation.holds.pushes import (
    PlatePush,
    PushSampling,
    generate_pushes,
    given_pushes,
    largest_tip,
    least_thickness,
    lowest_contact,
)
from planners.scene.lift_placements import GivenPush
from tests.support.polyhedra import face_normal

TIP, REACH = 0.010, 0.5
SAMPLING = PushSampling()
ACRYLIC = ConvexPrism.from_outline(rectangle(0.3, 0.3), 0.04)
PLYWOOD = ConvexPrism.from_outline(rectangle(0.4, 0.5), 0.044)


def random_plate(seed: int) -> ConvexPrism:
    points = np.random.default_rng(seed).normal(scale=0.2, size=(7, 2))
    return ConvexPrism.from_outline(points[ConvexHull(points).vertices], 0.03)


PLATES = [
    ACRYLIC,
    PLYWOOD,
    ConvexPrism.from_outline([[0, 0], [0.5, 0.05], [0.1, 0.4]], 0.02),
    *(random_plate(seed) for seed in range(6)),
]


@pytest.fixture(params=range(len(PLATES)))
def plate(request) -> ConvexPrism:
    return PLATES[request.param]


def outside(plate: ConvexPrism, points: np.ndarray) -> np.ndarray:
    """(m,) largest distance of each point beyond a face's plane."""
    body = plate.polyhedron
    planes = [(face_normal(body, k), body.vertices[face[0]]) for k, face in enumerate(body.faces)]
    return np.max([(points - corner) @ normal for normal, corner in planes], axis=0)


def test_the_papers_plates_have_the_papers_numbers_of_pushes():
    assert len(generate_pushes(ACRYLIC, TIP, REACH)) == 64
    assert len(generate_pushes(PLYWOOD, TIP, REACH)) == 72


def test_contacts_are_on_the_surface_and_normals_point_into_the_plate(plate):
    pushes = generate_pushes(plate, TIP, REACH)
    assert pushes
    assert [push.index for push in pushes] == list(range(len(pushes)))
    points, normals = np.array([p.point for p in pushes]), np.array([p.normal for p in pushes])
    assert outside(plate, points) == pytest.approx(np.zeros(len(pushes)), abs=1e-12)
    assert outside(plate, points - 1e-3 * normals) == pytest.approx(np.full(len(pushes), 1e-3))
    assert np.all(outside(plate, points + 1e-3 * normals) < -1e-4)


def test_the_stick_is_inside_the_push_cone(plate):
    for push in generate_pushes(plate, TIP, REACH):
        assert np.linalg.norm(push.axis) == pytest.approx(1.0)
        assert math.acos(float(push.axis @ push.normal)) <= math.radians(70) + 1e-9


def test_directions_outside_a_narrower_cone_are_left_out():
    narrow = generate_pushes(ACRYLIC, TIP, REACH, PushSampling(axis_angle_max=math.radians(30)))
    assert len(narrow) == 16
    assert all(push.point[2] == 0.0 for push in narrow)


def test_the_tcp_is_the_tips_centre_with_z_along_the_stick_at_every_roll(plate):
    for push in generate_pushes(plate, TIP, REACH):
        assert push.T_plate_tcp.shape == (8, 4, 4)
        for T in push.T_plate_tcp:
            assert T[:3, 3] + TIP * push.normal == pytest.approx(push.point)
            assert T[:3, 2] == pytest.approx(push.axis)
            assert T[:3, :3].T @ T[:3, :3] == pytest.approx(np.eye(3), abs=1e-12)
            assert np.linalg.det(T[:3, :3]) == pytest.approx(1.0)
        x, y = push.T_plate_tcp[0, :3, 0], push.T_plate_tcp[0, :3, 1]
        turned = np.column_stack([push.T_plate_tcp[:, :3, 0] @ x, push.T_plate_tcp[:, :3, 0] @ y])
        turns = math.pi / 4 * np.arange(8)
        assert turned == pytest.approx(np.column_stack([np.cos(turns), np.sin(turns)]), abs=1e-12)


def test_the_stick_touches_the_plate_at_its_tip_only(plate):
    ways = np.linspace(0.001, 0.4, 200)
    for push in generate_pushes(plate, TIP, REACH):
        centre = push.T_plate_tcp[0, :3, 3]
        assert np.all(outside(plate, centre - ways[:, None] * push.axis) > TIP)


def test_at_the_sides_the_stick_comes_from_above_and_under_the_plate_from_below(plate):
    for push in generate_pushes(plate, TIP, REACH):
        if push.normal[2] == 0.0:
            assert 0.0 <= push.point[2] < 0.5 * plate.height
            assert push.axis[2] < 0.0
        else:
            assert push.point[2] == -0.5 * plate.height
            assert push.axis[2] > 0.0


@pytest.mark.parametrize("height", [0.014, 0.018, 0.02, 0.03, 0.04, 0.08])
def test_at_the_sides_the_tip_keeps_off_the_support_where_the_plate_is_thick_enough(height):
    sides = [
        push
        for push in generate_pushes(ConvexPrism.from_outline(rectangle(0.3, 0.3), height), TIP, REACH)
        if push.normal[2] == 0.0
    ]
    assert sides
    for push in sides:
        above_support = push.point[2] + 0.5 * height
        assert above_support >= min(TIP + TIP * SAMPLING.tip_clearance, height - TIP * SAMPLING.top_margin) - 1e-12
        assert push.point[2] == 0.0 or above_support <= TIP + TIP * SAMPLING.tip_clearance + 1e-12


def test_the_retreat_leaves_the_plate_and_moves_the_stick_back(plate):
    for push in generate_pushes(plate, TIP, REACH):
        assert np.linalg.norm(push.retreat) == pytest.approx(1.0)
        assert push.retreat @ push.normal < -0.1
        assert push.retreat @ push.axis < -0.1
        beside = push.normal - push.axis
        assert push.retreat @ beside == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("size", [[0.3, 0.3, 0.04], [0.4, 0.5, 0.044], [0.9, 0.2, 0.03]])
@pytest.mark.parametrize("axis", [0, 1])
def test_the_pushes_of_a_rectangle_are_symmetric(size, axis):
    def keys(pushes: tuple[PlatePush, ...], mirror: np.ndarray) -> set[tuple[float, ...]]:
        return {tuple(np.round([*(p.point * mirror), *(p.axis * mirror)], 9) + 0.0) for p in pushes}

    pushes = generate_pushes(ConvexPrism.from_outline(rectangle(*size[:2]), size[2]), TIP, REACH)
    mirror = np.ones(3)
    mirror[axis] = -1.0
    assert keys(pushes, mirror) == keys(pushes, np.ones(3))
    assert len(keys(pushes, mirror)) == len(pushes)


def test_generated_pushes_that_a_task_gives_itself_are_the_same_pushes(plate):
    pushes = generate_pushes(plate, TIP, REACH)
    given = [GivenPush(push.point, push.normal, push.axis) for push in pushes]
    for again, made in zip(given_pushes(given, TIP, SAMPLING.rolls), pushes, strict=True):
        assert again.index == made.index
        for name in ("point", "normal", "axis", "T_plate_tcp"):
            assert getattr(again, name) == pytest.approx(getattr(made, name), abs=1e-12)


def test_a_stick_may_stand_square_on_the_bottom():
    up = np.array([0.0, 0.0, 1.0])
    (push,) = given_pushes([GivenPush(np.array([0.0, 0.0, -0.02]), up, up)], TIP, 8)
    assert push.T_plate_tcp[3, :3, :3].T @ push.T_plate_tcp[3, :3, :3] == pytest.approx(np.eye(3), abs=1e-12)
    assert push.retreat == pytest.approx([0, 0, -1])


@pytest.mark.parametrize("wrong", [{"count": 0}, {"rolls": 0}, {"axis_angle_max": 2.0}, {"bottom_depth": -0.1}])
def test_samplings_that_mean_nothing_are_refused(wrong):
    with pytest.raises(LiftwrightError):
        PushSampling(**wrong)


@pytest.mark.parametrize("beyond", [0.0, 0.004, 0.5])
@pytest.mark.parametrize("margin", [0.001, 0.003])
def test_a_plate_is_pushed_at_its_sides_if_it_is_thicker_than_the_least(margin: float, beyond: float) -> None:
    """The tip keeps the margin from what a plate lies on that is just thicker, and only there."""
    sampling = PushSampling()
    least = least_thickness(TIP, margin, sampling, beyond)
    for thickness, has_room in ((least + 1e-4, True), (least - 1e-4, False)):
        plate = ConvexPrism.from_outline(rectangle(0.3, 0.3), thickness)
        half, middle = np.array([0.15 + beyond, 0.15 + beyond, 0.025]), np.array([0.0, 0.0, -0.5 * thickness - 0.025])
        pushes = generate_pushes(plate, TIP, REACH, sampling, lowest=lowest_contact(TIP, margin, beyond))
        at_sides = [push for push in pushes if abs(push.normal[2]) < 0.5]
        below_top = 0.5 * thickness - np.array([push.point[2] for push in at_sides])
        assert below_top == pytest.approx(sampling.least_top_margin)
        centres = np.array([push.T_plate_tcp[0, :3, 3] for push in at_sides])
        distances = np.linalg.norm(np.maximum(np.abs(centres - middle) - half, 0.0), axis=1)
        assert (distances.min() >= TIP + margin) == has_room


@pytest.mark.parametrize("beyond", [0.0, 0.004, 0.02, 0.5])
def test_the_largest_tip_that_has_room_is_the_one_for_which_a_plate_is_just_thick_enough(beyond: float) -> None:
    sampling = PushSampling()
    for thickness in (0.0045, 0.008, 0.012, 0.03):
        tip = largest_tip(thickness, 0.003, sampling, beyond)
        assert tip > 0.0
        assert least_thickness(tip, 0.003, sampling, beyond) == pytest.approx(thickness, rel=1e-12)
    assert largest_tip(0.003, 0.003, sampling, beyond) < 0.0, "the margins alone are more"


def test_a_thin_plate_is_pushed_as_far_from_its_top_face_as_the_tip_has_room():
    lowest = lowest_contact(TIP, 0.003, 0.0)
    for thickness in (0.0095, 0.0105, 0.011):
        plate = ConvexPrism.from_outline(rectangle(0.3, 0.3), thickness)
        pushes = generate_pushes(plate, TIP, REACH, lowest=lowest)
        heights = {0.5 * thickness + push.point[2] for push in pushes if abs(push.normal[2]) < 0.5}
        assert all(lowest < height < lowest + 3e-4 or height == pytest.approx(thickness - 0.001) for height in heights)
        assert max(heights) <= thickness - SAMPLING.least_top_margin + 1e-12
