"""Compliant holds: what they bear, and that no body is too light for them."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from planners.contract.task_spec import SuctionToolTask, read_task
from planners.geometry.pose import Array, Transform, inverse, rotation_from_vector, skew, transform
from planners.scene.tool_scene import SuctionToolScene, build_tool_scene
from workers.simulation.holds import Bond, Chain, CupHold
from workers.simulation.settings import LIP_RADIUS, BondStiffness, ToolSimulationSettings, TruthSettings
from workers.simulation.world import FreeBody, ToolWorld

TASK = Path(__file__).resolve().parents[2] / "assets" / "tasks" / "domino_pile.json"
HOLD = BondStiffness(linear=100e3, angular=40.0, damping_time=0.004)
LIFT = transform(position=[0.0, 0.0, 0.2])
GRAVITY = np.array([0.0, 0.0, -9.81])


def small_motion(T_from: Transform, T_to: Transform) -> Array:
    """Return the (6,) way from one pose to another that is near: translation, and axis times sine of the angle."""
    turn = T_to[:3, :3] @ T_from[:3, :3].T
    turned = 0.5 * np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
    return np.concatenate([T_to[:3, 3] - T_from[:3, 3], turned])


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


def twist_at(body: FreeBody, point: Array) -> Array:
    """Return the (6,) velocity of a body at a point (3,) of the world, world axes."""
    center, velocity, spin = body.motion[3:]
    return np.concatenate([velocity + np.cross(spin, point - center), spin])


def mobility(body: FreeBody, one: Array, other: Array) -> Array:
    """Return (6, 6): how fast the twist at a point changes under a wrench about another point, world axes."""
    R, center = body.motion[:3], body.motion[3]
    to_one, from_other = np.eye(6), np.eye(6)
    to_one[:3, 3:], from_other[3:, :3] = -skew(one - center), skew(other - center)
    inverse_inertia = np.zeros((6, 6))
    inverse_inertia[:3, :3], inverse_inertia[3:, 3:] = np.eye(3) / body.mass, R @ np.diag(1.0 / body.moments) @ R.T
    return to_one @ inverse_inertia @ from_other


def hang(world: ToolWorld, bonds: list[Bond], scene: SuctionToolScene, seconds: float) -> None:
    chain = Chain(bonds)
    for _ in range(round(seconds / 0.002)):
        for bond in bonds:
            bond.follow(bond.T_world_parent if bond.parent is None else bond.parent.T_world_body)
        chain.exert(0.002, GRAVITY)
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


@pytest.mark.parametrize("width", [0.6, 1.0, 1.9])
def test_a_cup_gives_way_as_a_ring_of_springs_under_its_lip(tool_scene: SuctionToolScene, width: float) -> None:
    """The same lip on a wider cup: as many springs per length, farther from the middle."""

    def ring(radius: float) -> Array:
        angles = np.linspace(0.0, 2.0 * np.pi, 360, endpoint=False)
        spring = 2.0 * np.pi * radius / len(angles)
        return np.array([spring * len(angles), np.sum(spring * (radius * np.sin(angles)) ** 2)])

    scene, settings = tool_above(raised(tool_scene)), ToolSimulationSettings()
    cup = replace(scene.tool.cup, radius=width * LIP_RADIUS)
    with ToolWorld(scene, settings) as world:
        hold = CupHold(world.tool, world.bodies[scene.objects[0].name], cup, settings)
    expected = ring(cup.radius) / ring(LIP_RADIUS)
    assert hold.bond.stiffness[:3] / settings.cup.linear == pytest.approx(expected[0])
    assert hold.bond.stiffness[3:] / settings.cup.angular == pytest.approx(expected[1])


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
        expected = 0.002 * (mobility(item, seen, pushed) @ push + np.concatenate([GRAVITY, np.zeros(3)]))
        before = item.center.copy()
        item.push(push, pushed)
        world.drive(scene.start_positions, np.zeros(12))
        world.advance()
        assert twist_at(item, seen + item.center - before) == pytest.approx(expected, rel=2e-3, abs=1e-6)


@pytest.mark.parametrize("seed", range(3))
def test_the_wrenches_of_a_chain_are_those_of_springs_and_dampers_at_the_end_of_the_step(
    tool_scene: SuctionToolScene, seed: int
) -> None:
    """F = K (x + h u') + C u' of all bonds at once, with the velocities u' that all of them together leave."""
    scene, rng, step = tool_above(raised(tool_scene)), np.random.default_rng(seed), 0.002

    def small_pose() -> Array:
        return transform(rotation_from_vector(0.01 * rng.normal(size=3)), 0.002 * rng.normal(size=3))

    with ToolWorld(scene, ToolSimulationSettings()) as world:
        tool, item = world.tool, world.bodies[scene.objects[0].name]
        places = [tool.T_world_body @ transform(position=[0.0, 0.0, z]) for z in (0.10, 0.15)]
        bonds = [*(Bond(tool, None, T, HOLD) for T in places), Bond(item, tool, tool.T_world_body, HOLD)]
        rests = [inverse(bond.child.T_world_body) @ bond.T_world_parent for bond in bonds]
        tool.push(rng.normal(size=6), tool.center)
        item.push(rng.normal(size=6), item.center)
        world.drive(scene.start_positions, np.zeros(12))
        world.advance()
        for bond, T in zip(bonds, places, strict=False):
            bond.follow(small_pose() @ T, 0.01 * rng.normal(size=6))
        bonds[2].follow(tool.T_world_body)
        Chain(bonds).exert(step, GRAVITY)

        after = {body: step * np.concatenate([GRAVITY, np.zeros(3)]) for body in (tool, item)}

        def gained(body: FreeBody, at: Array) -> Array:
            """What all bonds and its weight do to a body's velocity at a place."""
            pushes = [(b.wrench, b.point) for b in bonds if b.child is body]
            pushes += [(-b.wrench, b.point) for b in bonds if b.parent is body]
            return after[body] + step * sum(mobility(body, at, place) @ wrench for wrench, place in pushes)

        for bond, T_child_rest in zip(bonds, rests, strict=True):
            x = small_motion(bond.child.T_world_body @ T_child_rest, bond.T_world_parent)
            child, parent = twist_at(bond.child, bond.point) + gained(bond.child, bond.point), bond.hand_twist
            if bond.parent is not None:
                parent = twist_at(bond.parent, bond.point) + gained(bond.parent, bond.point)
            u = parent - child
            expected = bond.stiffness * (x + step * u) + bond.damping * u
            assert bond.wrench == pytest.approx(expected, rel=1e-6, abs=1e-6)


def test_a_body_lies_where_it_was_put(tool_scene: SuctionToolScene) -> None:
    with ToolWorld(tool_scene, ToolSimulationSettings()) as world:
        hang(world, [], tool_scene, 0.5)
        for body in (tool_scene.tool.body, tool_scene.objects[0].body):
            assert world.bodies[body.name].T_world_body == pytest.approx(body.T_world_body, abs=1e-3)
