"""Whole turns, against brute force."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from planners.kinematics.windings import all_windings, nearest_winding, wrap

TURN = 2 * math.pi


def brute_force(q: np.ndarray, lo: np.ndarray, hi: np.ndarray) -> np.ndarray:
    """List all combinations of up to three turns within the limits."""
    turned = q[:, None] + TURN * np.arange(-3, 4)
    choices = [row[(low <= row) & (row <= high)] for row, low, high in zip(turned, lo, hi, strict=True)]
    return np.array(list(itertools.product(*choices))).reshape(-1, len(q))


def random_limits(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    lo = rng.uniform(-2.5 * TURN, TURN, 6)
    return lo, lo + rng.uniform(0.6, 2.2, 6) * TURN


def test_windings_are_all_there_are_and_none_twice():
    rng = np.random.default_rng(0)
    for _ in range(100):
        q = rng.uniform(-math.pi, math.pi, 6)
        lo, hi = random_limits(rng)
        np.testing.assert_allclose(all_windings(q, lo, hi), brute_force(q, lo, hi), atol=1e-12)


def test_nearest_winding_is_the_nearest_of_all():
    rng = np.random.default_rng(1)
    for _ in range(300):
        q, reference = rng.uniform(-math.pi, math.pi, 6), rng.uniform(-2 * TURN, 2 * TURN, 6)
        lo, hi = random_limits(rng)
        everywhere = brute_force(q, lo, hi)
        found = nearest_winding(q, reference, lo, hi)
        if len(everywhere):
            np.testing.assert_allclose(found, everywhere[np.abs(everywhere - reference).sum(axis=1).argmin()])
        else:
            assert np.isnan(found).any()


def test_a_joint_without_a_position_in_its_range_is_told():
    q, lo, hi = np.full(6, 2.0), np.full(6, -TURN), np.full(6, TURN)
    lo[3], hi[3] = 0.0, 1.0
    assert all_windings(q, lo, hi).shape == (0, 6)
    found = nearest_winding(q, q, lo, hi)
    assert list(np.isnan(found)) == [False, False, False, True, False, False]


@pytest.mark.parametrize("position", [math.pi + 4e-10, -math.pi - 4e-10])
def test_a_position_beyond_its_limit_by_rounding_is_put_on_the_limit(position):
    q, lo, hi = np.full(6, position), np.full(6, -math.pi), np.full(6, math.pi)
    windings = all_windings(q, lo, hi)
    assert len(windings) == 2**6
    assert (np.abs(windings) <= math.pi).all()
    assert (np.abs(nearest_winding(q, q, lo, hi)) <= math.pi).all()


def test_a_joint_of_two_turns_stands_at_its_middle_in_three_ways():
    windings = all_windings(np.zeros(1), np.array([-TURN]), np.array([TURN]))
    np.testing.assert_allclose(windings[:, 0], [-TURN, 0.0, TURN])


def test_wrapping_keeps_the_direction_and_ends_in_the_half_open_turn():
    rng = np.random.default_rng(2)
    angles = [*rng.uniform(-50.0, 50.0, 1000), math.pi, -math.pi, 3 * math.pi, -3 * math.pi, 0.0]
    for angle in angles:
        wrapped = wrap(float(angle))
        assert -math.pi < wrapped <= math.pi
        assert abs(np.exp(1j * wrapped) - np.exp(1j * angle)) < 1e-13
