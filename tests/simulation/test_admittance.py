"""The compiled parts of a hand's step, against the algebra as it is written down."""

from __future__ import annotations

import numpy as np
import pytest

from planners.geometry.pose import Array, rotation_from_vector, transform
from planners.scene.lift_scene import PlateLiftScene
from workers.simulation.hands import admit
from workers.simulation.settings import SimulationSettings
from workers.simulation.world import LiftWorld

PERIOD, FADED = 0.01, 0.2


def turned(R: Array, vector: Array) -> Array:
    """Turn both halves of a vector (6,)."""
    return np.concatenate([R @ vector[:3], R @ vector[3:]])


def shortened(most: float, vector: Array) -> Array:
    return vector * min(1.0, most / float(np.linalg.norm(vector)))


@pytest.mark.parametrize("seed", range(20))
def test_an_admittance_follows_the_error_and_gives_way(seed: int) -> None:
    rng = np.random.default_rng(seed)
    wrench, reading, trim, forward = rng.normal(size=(4, 6))
    spread, admittance = rng.normal(size=(6, 6)), rng.uniform(size=6)
    T_world_plate = transform(rotation_from_vector(rng.normal(size=3)), rng.normal(size=3))
    compliance, R, limits = spread @ spread.T, T_world_plate[:3, :3], rng.uniform(0.5, 2.5, 3)
    gives_way = turned(R, compliance @ turned(R.T, wrench))
    followed = trim + PERIOD * ((wrench - reading) * admittance - limits[0] * trim)
    wanted_trim = np.concatenate([shortened(limits[1], followed[:3]), shortened(limits[2], followed[3:])])
    wanted_forward = forward + FADED * (gives_way - forward)
    admit(wrench, reading, R, compliance, admittance, limits, PERIOD, FADED, trim, forward)
    assert trim == pytest.approx(wanted_trim, rel=1e-12, abs=1e-13)
    assert forward == pytest.approx(wanted_forward, rel=1e-12, abs=1e-13)


def test_hands_found_together_are_those_found_one_by_one(scene: PlateLiftScene) -> None:
    rng = np.random.default_rng(0)
    with LiftWorld(scene, SimulationSettings()) as world:
        world.positions[:], world.velocities[:] = rng.normal(size=(2, 12))
        frames = np.array([transform(rotation_from_vector(rng.normal(size=3)), rng.normal(size=3)) for _ in range(2)])
        together = world.hands(frames)
        for i, name in enumerate(scene.cell.arms):
            for mine, theirs in zip(together, world.hand(name, frames[i]), strict=True):
                assert np.array_equal(mine[i], theirs)
