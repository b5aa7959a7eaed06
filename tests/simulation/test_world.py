"""The cell in PyBullet."""

from __future__ import annotations

import numpy as np
import pytest

from planners.kinematics.forward import flange_pose, jacobian
from workers.simulation.settings import SimulationSettings
from workers.simulation.world import LiftWorld

SETTINGS = SimulationSettings()


def advance(world: LiftWorld, scene, seconds: float, wrench=None) -> None:
    for _ in range(round(seconds / SETTINGS.step)):
        world.drive(scene.start_positions, np.zeros(12))
        if wrench is not None:
            world.push_hand("left", wrench, world.hand("left", np.eye(4))[0][:3, 3])
        world.advance()


def test_the_plate_rests_where_it_was_put_and_the_support_bears_its_weight(scene) -> None:
    with LiftWorld(scene, SETTINGS) as world:
        advance(world, scene, 0.5)
        assert world.plate.T_world_body == pytest.approx(scene.T_world_plate, abs=3e-4)
        assert world.resting_force() == pytest.approx([0.0, 0.0, scene.plate.mass * 9.81], abs=0.05)


def test_arms_that_are_told_to_stand_stand(scene) -> None:
    with LiftWorld(scene, SETTINGS) as world:
        advance(world, scene, 0.3)
        assert world.positions == pytest.approx(scene.start_positions, abs=1e-3)


def test_a_wrench_on_a_hand_is_borne_by_the_joints_through_the_jacobian(scene) -> None:
    """And so the arm in PyBullet has the kinematics of the plan: torques differ by J^T w, links' weights aside."""
    arm = scene.cell.arms["left"]
    wrench = np.array([3.0, -2.0, 8.0, 0.6, -0.4, 0.3])
    with LiftWorld(scene, SETTINGS) as world:
        advance(world, scene, 0.4)
        before = world.torques[:6].copy()
        advance(world, scene, 0.4, wrench)
        after = world.torques[:6].copy()
    q = scene.start_positions[:6]
    at = flange_pose(arm.dh, arm.T_world_base, q)[:3, 3].copy()
    expected = -jacobian(arm.dh, arm.T_world_base, q, at).T @ wrench
    assert after - before == pytest.approx(expected, abs=0.15)


def test_a_wrench_on_the_plate_moves_it_as_newton_says(scene) -> None:
    mass = scene.plate.mass
    with LiftWorld(scene, SETTINGS) as world:
        world.plate.push(np.array([2.0, 0.0, mass * 9.81 + 40.0, 0.0, 0.0, 0.1]), world.plate.center)
        world.drive(scene.start_positions, np.zeros(12))
        world.advance()
        velocity, spin = world.plate.motion[4:]
        assert velocity == pytest.approx(np.array([2.0, 0.0, 40.0]) / mass * SETTINGS.step, rel=1e-3, abs=1e-6)
        x, y, _ = np.ptp(scene.plate.solid.convex.vertices, axis=0)
        assert spin[2] == pytest.approx(0.1 / (mass / 12.0 * (x * x + y * y)) * SETTINGS.step, rel=1e-3)
