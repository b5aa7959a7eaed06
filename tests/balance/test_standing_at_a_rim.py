"""A plate at the rim of what it stands on: forces are possible with its own edge and with the rim's."""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from typing import Any, get_args

import numpy as np
import pytest

from planners.balance.balanced import Balanced
from planners.balance.contacts import contact_axes, standing_cones
from planners.balance.proofs import TwistTable
from planners.contract.task_spec import LifterModel
from planners.geometry.pose import rotation_x, rotation_z
from tests.support.samples import sample

CASES = list(product(get_args(LifterModel), (1, 2, 4), (False, True), (False, True), sample(range(2), range(6))))
ROUNDS = np.linspace(-np.pi, np.pi, 73)
SLACK = 1e-7


def within(forces: np.ndarray, normal: np.ndarray, mu: float) -> np.ndarray:
    """By how much forces (n, 3) are inside a friction cone."""
    pressed = forces @ normal
    return mu * pressed - np.linalg.norm(forces - pressed[:, None] * normal, axis=1)


@pytest.mark.parametrize("tilt", [0.0, 0.05, 0.3, 0.6, 0.75])
@pytest.mark.parametrize("mu", [0.3, 0.4, 0.8])
def test_the_cone_at_a_rim_is_the_largest_within_those_of_both_edges(tilt: float, mu: float) -> None:
    point = np.array([[0.1, -0.2, -0.02]])
    up = rotation_x(tilt)[2] @ rotation_z(0.7)
    cones = standing_cones(point, up, point[:, :2], mu, 1.0)
    (normal,), (own,) = cones.normals, np.asarray(cones.mu)
    bottom = np.array([0.0, 0.0, 1.0])
    if not normal.any():
        # Nothing is in both cones.
        assert tilt > 2.0 * np.arctan(mu)
        assert within((up + bottom)[None], up, mu)[0] < 0.0
        return
    assert tilt <= 2.0 * np.arctan(mu)

    def rim_of(share: float) -> np.ndarray:
        around = np.column_stack([np.cos(ROUNDS), np.sin(ROUNDS)]) * share * own
        return np.column_stack([around, np.ones(len(ROUNDS))]) @ contact_axes(normal).T

    both = [within(rim_of(1.0), each, mu).min() for each in (up, bottom)]
    assert min(both) > -1e-12
    assert min(within(rim_of(1.05), each, mu).min() for each in (up, bottom)) < -1e-4 * own


def test_elsewhere_it_is_that_of_the_surface() -> None:
    points = np.array([[0.1, -0.2, -0.02], [0.1, 0.2, -0.02]])
    up = rotation_x(0.3)[2]
    cones = standing_cones(points, up, points[:1, :2], 0.4, 7.0)
    assert (cones.normals[1] == up).all()
    assert np.asarray(cones.mu)[1] == 0.4
    assert np.asarray(cones.largest)[1] == 7.0
    alone = standing_cones(points, up, points[:0, :2], 0.4, 7.0)
    assert (alone.normals == up).all()
    assert (alone.mu, alone.largest) == (0.4, 7.0)


@pytest.fixture(scope="module")
def at_rims(random_lift: Any) -> list[tuple[Any, Any]]:
    """Lifts whose points all stand at a rim, each with its answer."""
    found = []
    for *structure, seed in CASES:
        lift = random_lift(seed, *structure)
        balance = lift.balance.with_rim(lift.environment_points[:, :2])
        found.append((lift, balance.solve(lift.rotation, lift.environment_points, lift.grip, lift.push)))
    return found


def test_what_is_held_is_held_by_forces_that_either_edge_can_exert(at_rims: list[tuple[Any, Any]]) -> None:
    held = [(lift, answer) for lift, answer in at_rims if isinstance(answer, Balanced)]
    assert 0.15 < len(held) / len(at_rims) < 0.85
    for lift, answer in held:
        names = [name.startswith("environment") for name in answer.contacts]
        forces = answer.wrenches_world[names, :3]
        assert len(forces) == len(lift.environment_points)
        for normal in (np.array([0.0, 0.0, 1.0]), lift.rotation[:, 2]):
            assert within(forces, normal, lift.plate.friction.environment).min() > -SLACK
        arms = (answer.points - lift.plate.com) @ lift.rotation.T
        every, torques = answer.wrenches_world[:, :3], answer.wrenches_world[:, 3:]
        assert np.abs(every.sum(axis=0) - [0, 0, lift.plate.mass * 9.81]).max() < 1e-8
        assert np.abs((torques + np.cross(arms, every)).sum(axis=0)).max() < 1e-8


def test_what_is_held_at_a_rim_is_held_elsewhere_and_flat_plates_alike(at_rims: list[tuple[Any, Any]]) -> None:
    lost = 0
    for lift, answer in at_rims:
        elsewhere = isinstance(lift.solve(), Balanced)
        assert elsewhere or not isinstance(answer, Balanced)
        lost += elsewhere and not isinstance(answer, Balanced)
        if len(lift.environment_points) == 4:
            assert elsewhere == isinstance(answer, Balanced)
    assert lost > 0


def test_a_proof_at_a_rim_leaves_no_power_to_anything_that_touches(at_rims: list[tuple[Any, Any]]) -> None:
    """Of hands and cup cvxpy is asked; of the rim's narrower cones the best point has all of the force."""
    proven = 0
    for lift, answer in at_rims[:: sample(5, 2)]:
        if isinstance(answer, Balanced) or answer.proof is None:
            continue
        twist, points = answer.proof.twist, lift.environment_points
        velocities = twist[:3] + np.cross(twist[3:], points - lift.plate.com)
        bound = lift.balance.environment_bound
        cones = standing_cones(points, lift.rotation[2], points[:, :2], lift.plate.friction.environment, bound)
        best = 0.0
        for velocity, normal, mu, largest in zip(velocities, *map(np.asarray, cones), strict=True):
            outward = float(normal @ velocity)
            best = max(best, largest * (outward + mu * np.linalg.norm(velocity - outward * normal)))
        alone = replace(lift, environment_points=points[:0])
        assert alone.most_power(alone.state(), twist) + best < 1e-6
        proven += 1
    assert proven > 2


def test_a_proof_declares_no_node_that_can_be_held_at_a_rim(random_lift: Any, random_hands: Any) -> None:
    rng = np.random.default_rng(4)
    lifts = [random_lift(seed, "paper", count, False, False) for seed, count in enumerate((1, 2, 4, 1, 2))]
    half = lifts[0].half
    corners = half * np.array([[-1, -1, -1], [-1, 1, -1], [1, 1, -1], [1, -1, -1]])
    # Two of the four corners stand at the rim.
    balance = lifts[0].balance.with_rim(corners[1:3, :2])
    rotations, points = [each.rotation for each in lifts], [corners[: len(each.environment_points)] for each in lifts]
    grips, pushes = zip(*(random_hands(rng, half) for _ in range(3)), strict=True)
    table = TwistTable(balance, np.array(rotations), points, grips, pushes)
    held, proofs = np.zeros((len(lifts), 4, 4), bool), []
    for pose, grip, push in product(range(len(lifts)), range(4), range(4)):
        hands = None if grip == 0 else grips[grip - 1], None if push == 0 else pushes[push - 1]
        answer = balance.solve(rotations[pose], points[pose], *hands)
        held[pose, grip, push] = isinstance(answer, Balanced)
        if not isinstance(answer, Balanced) and answer.proof is not None:
            assert table.infeasible(answer.proof)[pose, grip, push]
            proofs.append(answer.proof)
    assert 0.1 < held.mean() < 0.9
    assert proofs
    assert not any((table.infeasible(proof) & held).any() for proof in proofs)
