"""Compliant holds: what they bear, and that no body is too light for them."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from planners.contract.task_spec import SuctionToolTask, read_task
from planners.geometry.pose import transform
from planners.scene.tool_scene import SuctionToolScene, build_tool_scene
from workers.simulation.holds import Bond, exert
from workers.simulation.settings import BondStiffness, ToolSimulationSettings, TruthSettings
from workers.simulation.world import ToolWorld

TASK = Path(__file__).resolve().parents[2] / "assets" / "tasks" / "domino_pile.json"
HOLD = BondStiffness(linear=100e3, angular=40.0, damping_time=0.004)
LIFT = transform(position=[0.0, 0.0, 0.2])
GRAVITY = np.array([0.0, 0.0, -9.81])


@pytest.fixture(scope="module")
def tool_scene() -> SuctionToolScene:
    body = json.loads(TASK.read_text())
    body["objects"] = [{**body["objects"][0], "com": [0.02, 0.01, 0.0]}]
    task = read_task(body)
    assert isinstance(task, SuctionToolTask)
    return build_tool_scene(task)


def raised(scene: SuctionToolScene) -> SuctionToolScene:
    """Return the scene with its object in the air over its place."""
    (moved,) = scene.objects
    body = replace(moved.body, T_world_body=LIFT @ moved.body.T_world_body)
    return replace(scene, objects=(replace(moved, body=body),))


def tool_above(scene: SuctionToolScene) -> SuctionToolScene:
    """Return the scene with its tool over its object."""
    T_world_tool = scene.objects[0].body.T_world_body @ transform(position=[0.0, 0.0, 0.03])
    return replace(scene, tool=replace(scene.tool, body=replace(scene.tool.body, T_world_body=T_world_tool)))


def hang(world: ToolWorld, bonds: list[Bond], scene: SuctionToolScene, seconds: float) -> None:
    for _ in range(round(seconds / 0.002)):
        for bond in bonds:
            bond.follow(bond.T_world_parent if bond.parent is None else bond.parent.T_world_body)
        exert(bonds, 0.002, GRAVITY)
        world.drive(scene.start_positions, np.zeros(12))
        world.advance()


@pytest.mark.parametrize("factor", [0.02, 1.0, 50.0])
def test_a_hold_bears_weight_and_moment_whatever_the_mass_and_gives_way_as_hooke_says(
    tool_scene: SuctionToolScene, factor: float
) -> None:
    scene = raised(tool_scene)
    settings = replace(ToolSimulationSettings(), truth=TruthSettings(object_mass=factor))
    with ToolWorld(scene, settings) as world:
        item = world.bodies[scene.objects[0].name]
        T_world_hold = item.T_world_body
        bond = Bond(item, None, T_world_hold, HOLD)
        hang(world, [bond], scene, 1.5)
        weight = -factor * 0.1 * GRAVITY
        lever = item.center - T_world_hold[:3, 3]
        assert bond.wrench == pytest.approx(np.concatenate([weight, np.cross(lever, weight)]), rel=1e-3, abs=1e-6)
        sag = T_world_hold[:3, 3] - item.T_world_body[:3, 3]
        assert sag[2] == pytest.approx(weight[2] / HOLD.linear, rel=0.02)


def test_in_a_chain_the_hand_bears_both_and_the_cup_the_last_alone(tool_scene: SuctionToolScene) -> None:
    scene = tool_above(raised(tool_scene))
    with ToolWorld(scene, ToolSimulationSettings()) as world:
        item = world.bodies[scene.objects[0].name]
        hand = Bond(world.tool, None, world.tool.T_world_body @ transform(position=[0.0, 0.0, 0.15]), HOLD)
        cup = Bond(item, world.tool, world.tool.T_world_body, HOLD)
        hang(world, [hand, cup], scene, 1.5)
        assert cup.wrench[:3] == pytest.approx([0.0, 0.0, 0.1 * 9.81], rel=1e-3, abs=1e-5)
        assert hand.wrench[:3] == pytest.approx([0.0, 0.0, 0.35 * 9.81], rel=1e-3, abs=1e-4)


def test_mobility_is_newtons_law_for_a_body_that_nothing_touches(tool_scene: SuctionToolScene) -> None:
    """A push about one point changes the twist at another as the mobility says, in PyBullet too."""
    scene = raised(tool_scene)
    push = np.array([0.4, -0.2, 0.3, 0.01, 0.02, -0.015])
    with ToolWorld(scene, ToolSimulationSettings()) as world:
        item = world.bodies[scene.objects[0].name]
        pushed, seen = item.center + np.array([[0.05, -0.02, 0.01], [-0.03, 0.04, 0.02]])
        expected = 0.002 * (item.mobility(seen, pushed) @ push + np.concatenate([GRAVITY, np.zeros(3)]))
        before = item.center.copy()
        item.push(push, pushed)
        world.drive(scene.start_positions, np.zeros(12))
        world.advance()
        assert item.twist_at(seen + item.center - before) == pytest.approx(expected, rel=2e-3, abs=1e-6)


def test_a_body_lies_where_it_was_put(tool_scene: SuctionToolScene) -> None:
    with ToolWorld(tool_scene, ToolSimulationSettings()) as world:
        hang(world, [], tool_scene, 0.5)
        for body in (tool_scene.tool.body, tool_scene.objects[0].body):
            assert world.bodies[body.name].T_world_body == pytest.approx(body.T_world_body, abs=1e-3)
