"""Compliant contacts with friction."""

from __future__ import annotations

import numpy as np
import pytest

from planners.geometry.pose import rotation_from_vector, transform
from workers.simulation.touch import Touch

MU = 0.6
REST = np.vstack([np.eye(3), np.zeros((3, 3))])
PADS = np.array([[x, y, z] for y in (-0.02, 0.02) for x in (-0.004, 0.004) for z in (-0.006, 0.006)])
INWARD = np.repeat([[0.0, 1.0, 0.0], [0.0, -1.0, 0.0]], 4, axis=0)


def pads(squeeze: float = 60.0) -> Touch:
    touch = Touch(PADS, normal=7000.0, tangential=3500.0, damping_time=0.004, mu=MU)
    touch.engage(np.eye(4), INWARD)
    touch.preload[:] = squeeze / 4.0
    return touch


def test_a_hand_where_it_engaged_squeezes_and_does_nothing_else() -> None:
    touch = pads()
    assert touch.act(np.eye(4), np.zeros(6), REST) == pytest.approx(np.zeros(6), abs=1e-12)
    assert touch.forces == pytest.approx(15.0 * INWARD)


@pytest.mark.parametrize("seed", range(5))
def test_small_motions_are_resisted_by_the_stiffness(seed: int) -> None:
    small = 1e-6 * np.random.default_rng(seed).normal(size=6)
    # A squeeze adds a stiffness of its own, as it moves along; here it is next to nothing.
    touch = pads(squeeze=0.2)
    hand = transform(rotation_from_vector(small[3:]), small[:3])
    assert touch.act(hand, np.zeros(6), REST) == pytest.approx(touch.stiffness() @ small, rel=1e-3, abs=2e-7)


@pytest.mark.parametrize("seed", range(5))
def test_no_point_leaves_its_friction_cone_or_pulls(seed: int) -> None:
    rng = np.random.default_rng(seed)
    touch = pads()
    for _ in range(50):
        hand = transform(rotation_from_vector(0.02 * rng.normal(size=3)), 0.003 * rng.normal(size=3))
        touch.act(hand, 0.05 * rng.normal(size=6), REST)
        press = np.einsum("ij,ij->i", touch.forces, INWARD)
        across = np.linalg.norm(touch.forces - press[:, None] * INWARD, axis=1)
        assert press.min() >= 0.0
        assert np.all(across <= MU * press + 1e-9)


def test_dragged_hands_slide_by_what_friction_does_not_hold() -> None:
    touch = pads()
    hand = transform(None, [0.010, 0.0, 0.0])
    force = touch.act(hand, np.zeros(6), REST)
    assert force[0] == pytest.approx(MU * 2.0 * 60.0)
    assert touch.slips == pytest.approx(np.full(8, 0.010 - MU * 15.0 / 3500.0))
    # The springs stay as long as friction holds them, and sliding is not done twice.
    assert touch.act(hand, np.zeros(6), REST)[0] == pytest.approx(force[0])
    assert touch.slips == pytest.approx(np.full(8, 0.010 - MU * 15.0 / 3500.0))


def test_the_total_is_about_the_plates_centre_of_mass_and_turns_with_the_world() -> None:
    R, com = rotation_from_vector([0.3, -0.2, 0.5]), np.array([0.3, 0.1, 1.2])
    touch, turned = pads(), pads()
    moved = transform(rotation_from_vector([0.001, 0.002, 0.0]), [2e-4, 1e-4, -1e-4])
    here = touch.act(moved, np.zeros(6), REST)
    T = transform(R, com)
    there = turned.act(T @ moved, np.zeros(6), np.vstack([R, com, np.zeros((2, 3))]))
    assert there == pytest.approx(np.concatenate([R @ here[:3], R @ here[3:]]))


def test_damping_takes_energy_out() -> None:
    rng = np.random.default_rng(0)
    for _ in range(20):
        twist = 1e-4 * rng.normal(size=6)
        assert pads().act(np.eye(4), twist, REST) @ twist > 0.0
