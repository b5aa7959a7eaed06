"""The camera's views show what they are for, reckoned with a pinhole camera."""

from __future__ import annotations

import numpy as np
import pytest
from support.documents import bodies_of

from app.viewer.scene_servers import FIELD_OF_VIEW, VIEWS
from planners.cell.cell import known_cells, load_cell
from planners.geometry.pose import Array

LAPTOP = 900.0 / 442.0
"""Width over height of the scene on a screen of 1366 x 768."""
LARGE_PLATE = np.array([0.5, 0.5, 0.05])
"""[m]"""
CORNERS = np.array(list(np.ndindex(2, 2, 2))) - 0.5
"""Of a box whose edges are 1."""


def projected(view: str, points: Array, body_position: Array) -> Array:
    """Return where points (n, 3) are in a picture that reaches from -1 to 1 to the right and upward."""
    position, target = VIEWS[view].in_world(body_position)
    forward = (target - position) / np.linalg.norm(target - position)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    axes = np.column_stack([right / LAPTOP, np.cross(right, forward)]) / np.tan(0.5 * FIELD_OF_VIEW)
    return (points - position) @ axes / ((points - position) @ forward)[:, None]


@pytest.mark.parametrize("cell", known_cells())
def test_the_overview_shows_the_whole_table_and_the_beam_that_bears_the_arms(cell: str) -> None:
    bodies = bodies_of(load_cell(cell))
    for name in ("table", "platform_crossbar"):
        corners = CORNERS * bodies[name]["shape"]["size"] + bodies[name]["pose"][:3]
        assert np.abs(projected("overview", corners, np.zeros(3))).max() < 1.0


@pytest.mark.parametrize("height", [1.1, 1.3, 1.6])
def test_the_close_view_shows_a_whole_plate_large_wherever_it_is(height: float) -> None:
    where = np.array([0.35, 0.1, height])
    seen = projected("close", CORNERS * LARGE_PLATE + where, where)
    assert np.abs(seen).max() < 1.0
    assert np.ptp(seen, axis=0).min() > 0.6


def test_seen_from_the_top_the_arms_hang_above_and_the_table_lies_straight() -> None:
    corners = np.array([[0.05, -0.9, 1.1], [0.05, 0.9, 1.1], [0.85, -0.9, 1.1], [0.85, 0.9, 1.1]])
    near_left, near_right, far_left, far_right = projected("top", corners, np.zeros(3))
    assert near_left[1] == pytest.approx(near_right[1])
    assert far_left[1] == pytest.approx(far_right[1])
    assert near_left[1] > far_left[1]
