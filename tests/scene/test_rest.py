"""Settling bodies onto what they rest on."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from planners.contract.shapes import Box
from planners.geometry.pose import rotation_angle, rotation_from_vector, rotation_x, rotation_z, transform
from planners.scene.rest import (
    REST_GAP,
    REST_TILT,
    LevelFace,
    Unsupported,
    find_footing,
    footprint,
    gaps,
    level_places,
    lowest_face,
    overhang,
    rests_level,
    settled,
    upper_surface,
)
from planners.scene.solid import CompoundSolid, solid_of

BOX = solid_of(Box(type="box", size=(0.2, 0.1, 0.06)))
SQUARE = LevelFace("square", 1.0, np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]]))
TINY = st.floats(-REST_TILT, REST_TILT)


@given(st.floats(-3, 3), TINY, TINY, st.floats(-1e-3, 1e-3))
def test_a_settled_body_lies_level_at_the_height_and_has_hardly_moved(yaw, roll, pitch, gap):
    T = transform(rotation_from_vector([roll, pitch, 0]) @ rotation_z(yaw), [0.3, 0.1, 1.03 + gap])
    face = lowest_face(BOX, T)
    T_settled = settled(face, T, 1.0)
    assert gaps(face, T_settled, 1.0) == pytest.approx(0, abs=1e-12)
    assert T_settled[:3, :3] @ face.normal == pytest.approx([0, 0, -1], abs=1e-12)
    assert rotation_angle(T[:3, :3], T_settled[:3, :3]) <= math.hypot(roll, pitch) + 1e-9
    assert T_settled[:2, 3] == pytest.approx(T[:2, 3])
    assert T_settled[:3, :3] @ T_settled[:3, :3].T == pytest.approx(np.eye(3), abs=1e-12)


@pytest.mark.parametrize(
    ("gap", "tilt", "rests"),
    [
        (0, 0, True),
        (REST_GAP, 0, True),
        (-REST_GAP, 0, True),
        (1.01 * REST_GAP, 0, False),
        (-1.01 * REST_GAP, 0, False),
        (0, 0.99 * REST_TILT, True),
        (0, 1.01 * REST_TILT, False),
        (0.95 * REST_GAP, 0.9 * REST_TILT, False),
    ],
)
def test_a_body_rests_within_a_millimetre_and_a_tenth_of_a_degree_at_every_corner(gap, tilt, rests):
    T = transform(rotation_x(tilt), [0, 0, 1.03 + gap])
    assert rests_level(lowest_face(BOX, T), T, 1.0) is rests


@pytest.mark.parametrize("quarter_turns", range(4))
def test_a_box_rests_on_whichever_face_is_down(quarter_turns):
    T = transform(rotation_x(quarter_turns * math.pi / 2), [0, 0, 1.0 + (0.03, 0.05)[quarter_turns % 2]])
    face = lowest_face(BOX, T)
    assert rests_level(face, T, 1.0)
    surface = upper_surface("box", BOX, settled(face, T, 1.0))
    assert surface.height == pytest.approx(1.0 + (0.06, 0.10)[quarter_turns % 2])


def test_a_footprint_and_a_top_seen_from_above_run_counter_clockwise():
    def area(corners):
        x, y = corners.T
        return 0.5 * float(x @ np.roll(y, -1) - y @ np.roll(x, -1))

    for R in (np.eye(3), rotation_x(math.pi / 2), rotation_x(math.pi)):
        T = transform(R, [0.3, 0, 1])
        assert area(footprint(lowest_face(BOX, T), T)) > 0
        assert area(upper_surface("box", BOX, T).outline) > 0


def test_the_top_of_a_leaning_body_is_no_surface():
    assert upper_surface("box", BOX, transform(rotation_x(0.1))) is None


def test_overhang_is_the_distance_over_the_edge_and_none_inside():
    assert overhang(np.array([[0.5, 0.2], [-0.5, -0.5]]), SQUARE) == 0.0
    assert overhang(np.array([[0.52, 0.2], [0.0, 0.0]]), SQUARE) == pytest.approx(0.02)


def stool(*feet: tuple[float, float]) -> CompoundSolid:
    """A board 0.1 m above the ground on thin legs."""
    leg, board = (solid_of(Box(type="box", size=size)) for size in ((0.02, 0.02, 0.1), (0.2, 0.2, 0.02)))
    legs = [(leg, transform(None, [x, y, 0.05])) for x, y in feet]
    return CompoundSolid((*legs, (board, transform(None, [0.0, 0.0, 0.11]))))


def test_a_body_with_feet_rests_on_what_these_stand_on_and_not_on_what_is_between_them():
    corners = [(x, y) for x in (-0.09, 0.09) for y in (-0.09, 0.09)]
    mat = solid_of(Box(type="box", size=(0.1, 0.1, 0.0008)))
    between = level_places("mat", mat, transform(None, [0.0, 0.0, 1.0004]))
    found = find_footing(
        stool(*corners), transform(None, [0.0, 0.0, 1.0]), np.array([0.0, 0.0, 0.1]), [SQUARE, *between]
    )
    assert not isinstance(found, Unsupported)
    assert found.supports == ("square",)
    alone = find_footing(stool(*corners), transform(None, [0.0, 0.0, 1.0]), np.array([0.0, 0.0, 0.1]), between)
    assert alone == Unsupported("rests on nothing: what is level below it is beside its feet")
