"""Sides as they are told to somebody who stands behind the robot."""

import math

import numpy as np
import pytest

from planners.geometry import polygon
from planners.geometry.sides import told_heading, told_side
from planners.remedies.directions import told_way

PLATE = polygon.rectangle(0.6, 0.3)


def turned(yaw):
    return np.array([[math.cos(yaw), -math.sin(yaw), 0], [math.sin(yaw), math.cos(yaw), 0], [0, 0, 1]])


@pytest.mark.parametrize("yaw", [0.0, 0.3, 0.8, 1.6, 2.5, -0.7, -3.0])
def test_whoever_pushes_a_side_as_it_is_told_pushes_it_outwards(yaw):
    """Nearest of eight headings to the way from the middle of the plate square through the side."""
    R, middles = turned(yaw), 0.5 * (PLATE + np.roll(PLATE, -1, axis=0))
    for k, middle in enumerate(middles):
        out = (R[:2, :2] @ middle) / np.linalg.norm(middle)
        nearest = max(
            (np.array([math.cos(eighth), math.sin(eighth)]) for eighth in np.arange(8) * math.pi / 4),
            key=lambda heading: float(heading @ out),
        )
        by_way = told_way(np.round(nearest, 9)).replace("1000 mm ", "").replace("707 mm ", "")
        assert told_side(PLATE, R, "edge", k) == told_heading(out) == by_way


def test_a_corner_is_between_the_sides_that_meet_there_however_long_they_are():
    for k in range(4):
        before, after = (told_side(PLATE, np.eye(3), "edge", side) for side in ((k - 1) % 4, k))
        assert set(told_side(PLATE, np.eye(3), "vertex", k).split(" and ")) == {before, after}
