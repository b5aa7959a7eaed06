"""The cell in PyBullet."""

from __future__ import annotations

import numpy as np
import pytest

from planners.contract.task_spec import SuctionToolTask, read_task
from planners.kinematics.forward import flange_pose, jacobian
from planners.scene.tool_scene import build_tool_scene
from workers.simulation.bullet import bullet, within_layer
from workers.simulation.settings import SimulationSettings, ToolSimulationSettings
from workers.simulation.world import LiftWorld, ToolWorld

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


def test_bodies_of_any_shape_rest_on_one_another_where_they_were_put() -> None:
    """A stack of three, and the tool, which is put together of several hulls: none floats on a layer of its own."""
    angles = np.linspace(0.0, 2.0 * np.pi, 5, endpoint=False)
    outline = [[0.07 * float(np.cos(angle)), 0.06 * float(np.sin(angle))] for angle in angles]
    shapes = [
        ({"type": "prism", "outline": outline, "height": 0.1}, 0.05),
        ({"type": "cylinder", "radius": 0.055, "height": 0.06}, 0.13),
        ({"type": "box", "size": [0.06, 0.05, 0.04]}, 0.18),
    ]
    where = [{"pose": [0.4, y, 1.094 + z, 1, 0, 0, 0]} for y in (0.2, -0.2) for _, z in shapes]
    objects = [
        {"name": f"body_{i}", "shape": shape, "mass": 0.3, **where[i], "goal_pose": where[i + 3]["pose"]}
        for i, (shape, _) in enumerate(shapes)
    ]
    task = read_task({"kind": "suction_tool", "objects": objects})
    assert isinstance(task, SuctionToolTask)
    scene = build_tool_scene(task)
    with ToolWorld(scene, ToolSimulationSettings()) as world:
        for _ in range(300):
            world.drive(scene.start_positions, np.zeros(12))
            world.advance()
        for body in (scene.tool.body, *(each.body for each in scene.objects)):
            assert world.bodies[body.name].T_world_body == pytest.approx(body.T_world_body, abs=2e-4)


@pytest.mark.parametrize("size", [(0.1, 0.05, 0.02), (0.1, 0.05, 0.001)])
def test_what_is_left_for_the_layer_is_as_far_inside_all_faces(size: tuple[float, float, float]) -> None:
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)]) * size
    depth = min(1e-3, 0.25 * min(size))
    inside = within_layer(corners)
    assert inside.min(axis=0) == pytest.approx([depth] * 3)
    assert inside.max(axis=0) == pytest.approx(np.array(size) - depth)


def test_what_a_hand_does_to_the_plate_but_for_its_tip_is_what_changes_its_momentum(scene) -> None:
    """The plate is pressed from below against the end of the stick, beside its middle, and touches nothing else."""
    mass, step = scene.plate.mass, SETTINGS.step
    press = np.array([0.0, 0.0, 1.5 * mass * 9.81, 0.0, 0.0, 0.0])
    with LiftWorld(scene, SETTINGS) as world:
        assert world.knock("left") is None
        T_world_flange, _ = world.hand("left", np.eye(4))
        stick = scene.cell.arms["left"].hand.stick
        ends = stick.vertices @ T_world_flange[:3, :3].T + T_world_flange[:3, 3]
        lowest = ends[ends[:, 2].argmin()]
        place = lowest + np.array([0.05, 0.0, -stick.radius - 0.5 * scene.plate.height - 1e-3])
        bullet.resetBasePositionAndOrientation(
            world.plate.id, place.tolist(), [0, 0, 0, 1], physicsClientId=world.client
        )
        world.plate.forget()
        knocks = 0
        for _ in range(60):
            before = world.plate.motion.copy()
            world.plate.push(press, before[3])
            advance(world, scene, step)
            after, knock = world.plate.motion, world.knock("left")
            force = mass * ((after[4] - before[4]) / step + [0.0, 0.0, 9.81]) - press[:3]
            knocks += knock is not None
            knock = np.zeros(6) if knock is None else knock
            assert knock[:3] == pytest.approx(force, abs=0.01 * np.linalg.norm(force) + 1e-6)
            # The stick is beside the middle towards -x, and pushes down.
            assert (knock[4] < 0.0) == (knock[2] < 0.0)
            assert world.resting_force() == pytest.approx(np.zeros(3))
    assert knocks > 5


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
