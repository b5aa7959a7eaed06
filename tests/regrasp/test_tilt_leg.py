"""Turning a level tool about the centre of mass of what hangs on it."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from planners.geometry.pose import inverse, rotation_y, rotation_z, transform
from planners.regrasp.motion.cartesian_path import TiltLeg, raising, tilt_of, turned_about

LEVEL = transform(rotation_z(0.7) @ rotation_y(0.5 * math.pi) @ rotation_z(1.1), [0.4, 0.1, 1.3])
T_TOOL_FLANGE = transform(rotation_y(0.9), [0.02, -0.1, 0.2])
PIVOT = np.array([0.45, 0.12, 1.31])


@pytest.mark.parametrize("tilt", [0.2, 1.2, 1.5])
def test_raising_takes_the_axis_of_the_tool_to_the_tilt_and_no_farther_than_it_must(tilt: float) -> None:
    turn = raising(LEVEL, tilt)
    assert tilt_of(turned_about(LEVEL, PIVOT, turn)) == pytest.approx(tilt)
    assert np.linalg.norm(turn) == pytest.approx(0.5 * math.pi - tilt)


def test_what_is_carried_turns_about_the_pivot_and_the_way_back_ends_where_the_way_began() -> None:
    leg = TiltLeg(LEVEL @ T_TOOL_FLANGE, PIVOT, raising(LEVEL, 1.2))
    in_flange = inverse(leg.T_world_flange) @ [*PIVOT, 1.0]
    poses = leg.at(np.linspace(0.0, 1.0, 7))
    np.testing.assert_allclose(poses @ in_flange, np.tile([*PIVOT, 1.0], (7, 1)), atol=1e-12)
    turned = Rotation.from_rotvec(leg.turn) * Rotation.from_matrix(leg.T_world_flange[:3, :3])
    np.testing.assert_allclose(poses[-1][:3, :3], turned.as_matrix(), atol=1e-12)
    np.testing.assert_allclose(leg.back().at(np.linspace(1.0, 0.0, 7)), poses, atol=1e-12)


def test_the_length_is_the_way_of_the_flange() -> None:
    leg = TiltLeg(LEVEL @ T_TOOL_FLANGE, PIVOT, np.array([0.0, 0.0, 0.4]))
    points = leg.at(np.linspace(0.0, 1.0, 2000))[:, :3, 3]
    way = float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())
    assert way <= leg.length + 1e-9
    square = TiltLeg(transform(None, PIVOT + np.array([0.3, 0.0, 0.0])), PIVOT, np.array([0.0, 0.0, 0.4]))
    assert square.length == pytest.approx(0.12)
