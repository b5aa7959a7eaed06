"""The camera's views show what they are for, reckoned with a pinhole camera."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from app.viewer.drawing.camera import FIELD_OF_VIEW, NO_OBSTACLES, VIEWS
from planners.cell.cell import known_cells, load_cell
from planners.geometry.pose import Array
from planners.kinematics.forward import flange_pose
from tests.support.documents import bodies_of
from tests.support.scaled_cell import scaled_cell

LAPTOP = 900.0 / 442.0
"""Width over height of the scene on a screen of 1366 x 768."""
LARGE_PLATE = np.array([0.5, 0.5, 0.05])
"""[m]"""
MIDDLE = np.zeros(3)
CORNERS = np.array(list(np.ndindex(2, 2, 2))) - 0.5
"""Of a box whose edges are 1."""


def projected(
    view: str, points: Array, cell: str, body_position: Array = MIDDLE, obstacles: Array = NO_OBSTACLES
) -> Array:
    """Return where points (n, 3) are in a picture that reaches from -1 to 1 to the right and upward."""
    position, target = VIEWS[view].place(load_cell(cell), body_position, obstacles)
    forward = (target - position) / np.linalg.norm(target - position)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    axes = np.column_stack([right / LAPTOP, np.cross(right, forward)]) / np.tan(0.5 * FIELD_OF_VIEW)
    return (points - position) @ axes / ((points - position) @ forward)[:, None]


@pytest.mark.parametrize("view", sorted(set(VIEWS) - {"close"}))
@pytest.mark.parametrize("cell", known_cells())
def test_a_cell_is_seen_whole_and_large_whatever_its_size(cell: str, view: str) -> None:
    """The table, the beam or pedestals that bear the arms as far as they rise above it, and the arms at home."""
    loaded = load_cell(cell)
    bodies = {name: CORNERS * body["shape"]["size"] + body["pose"][:3] for name, body in bodies_of(loaded).items()}
    corners = np.vstack([*bodies.values()])
    bases = [arm.T_world_base for arm in loaded.arms.values()]
    hands = [flange_pose(arm.dh, arm.T_world_base, arm.home) for arm in loaded.arms.values()]
    above = corners[corners[:, 2] >= bodies["table"][:, 2].min() - 1e-9]
    seen = projected(view, np.vstack([above, [T[:3, 3] for T in (*bases, *hands)]]), cell)
    assert np.abs(seen).max() < 1.0
    assert np.abs(seen).max() > 0.9


@pytest.mark.parametrize("view", sorted(set(VIEWS) - {"close"}))
def test_a_beam_above_the_table_is_in_the_picture_and_a_far_wall_does_not_shrink_it(view: str) -> None:
    cell = known_cells()[0]
    table = bodies_of(load_cell(cell))["table"]
    beam = CORNERS * [0.05, 0.8, 0.05] + [*table["pose"][:2], table["pose"][2] + 0.75]
    wall = CORNERS * [0.1, 9.0, 5.0] + [6.0, 0.0, 2.5]
    assert np.abs(projected(view, beam, cell, obstacles=beam)).max() < 1.0
    edge = CORNERS * table["shape"]["size"] + table["pose"][:3]
    small, large = (np.ptp(projected(view, edge, cell, obstacles=o), axis=0).max() for o in (wall, NO_OBSTACLES))
    assert small > 0.5 * large


@pytest.mark.parametrize("height", [1.1, 1.3, 1.6])
def test_the_close_view_shows_a_whole_plate_large_wherever_it_is(height: float) -> None:
    where = np.array([0.35, 0.1, height])
    seen = projected("close", CORNERS * LARGE_PLATE + where, known_cells()[0], where)
    assert np.abs(seen).max() < 1.0
    assert np.ptp(seen, axis=0).min() > 0.6


@pytest.mark.parametrize("cell", known_cells())
def test_seen_from_the_top_the_table_lies_straight_with_the_arms_above_it(cell: str) -> None:
    table = bodies_of(load_cell(cell))["table"]
    corners = CORNERS * table["shape"]["size"] + table["pose"][:3]
    near_left, near_right, far_left, far_right = projected("top", corners[1::2], cell)
    assert near_left[1] == pytest.approx(near_right[1])
    assert far_left[1] == pytest.approx(far_right[1])
    assert near_left[1] > far_left[1]


@pytest.mark.parametrize("view", sorted(VIEWS))
def test_a_cell_twice_as_large_is_looked_at_from_twice_as_far(view: str, tmp_path: Path) -> None:
    """To a millimetre: few corners stand for a link, to 0.2 mm in a cell of any size."""
    cells = ((1.0, load_cell("dual_ur3e_lift")), (2.0, scaled_cell("dual_ur3e_lift", 2.0, tmp_path)))
    small, large = (np.array(VIEWS[view].place(cell, times * LARGE_PLATE)) for times, cell in cells)
    assert large == pytest.approx(2.0 * small, abs=1e-3)
