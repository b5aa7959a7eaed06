"""What the hands accelerate of a plate, against the equations of motion."""

from __future__ import annotations

import numpy as np
import pytest

from planners.lifting.lift_loop import box_inertia, felt_mass

UP = np.array([0.0, 0.0, 1.0])
SIDES = np.array([0.4, 0.5, 0.04])
INERTIA = box_inertia(SIDES, 6.4)


def test_a_box_is_as_inert_as_many_pieces_of_it() -> None:
    rng = np.random.default_rng(0)
    pieces = (rng.random((200_000, 3)) - 0.5) * SIDES
    about = (pieces**2).sum(axis=1)[:, None] - pieces**2
    assert pytest.approx(6.4 * about.mean(axis=0), rel=0.01) == INERTIA


def test_one_bearer_under_the_centre_of_mass_accelerates_all_of_it() -> None:
    assert felt_mass(np.zeros((1, 3)), UP, 6.4, INERTIA) == pytest.approx(6.4)


def test_bearers_on_both_sides_of_the_centre_of_mass_accelerate_all_of_it() -> None:
    points = np.array([[0.1, 0.2, 0.0], [-0.1, -0.2, 0.0]])
    assert felt_mass(points, UP, 6.4, INERTIA) == pytest.approx(6.4)


def test_a_rod_that_is_lifted_at_its_end_is_a_quarter_as_heavy() -> None:
    rod = box_inertia(np.array([1.0, 1e-6, 1e-6]), 2.0)
    assert felt_mass(np.array([[0.5, 0.0, 0.0]]), UP, 2.0, rod) == pytest.approx(0.5)


@pytest.mark.parametrize("seed", range(5))
def test_it_is_the_least_of_all_motions_in_which_the_bearers_rise_alike(seed: int) -> None:
    """Gauss: of all accelerations that the bearers allow, a free body takes the one of least energy."""
    rng = np.random.default_rng(seed)
    points = rng.uniform(-0.2, 0.2, (2, 3))
    up = rng.normal(size=3)
    up /= np.linalg.norm(up)
    # Acceleration of a bearer along up: a . up + (w x p) . up.
    rows = np.hstack([np.tile(up, (2, 1)), np.cross(points, up)])
    weights = np.concatenate([np.full(3, 6.4), INERTIA])
    scaled = np.linalg.pinv(rows / np.sqrt(weights)) @ np.ones(2)
    assert felt_mass(points, up, 6.4, INERTIA) == pytest.approx(float(scaled @ scaled))
