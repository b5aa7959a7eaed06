"""Handovers with a load: where both arms are, which pairs of grasps remain, and which place comes first."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from planners.contract.task_spec import SuctionToolTask, read_task
from planners.geometry.pose import inverse, transform
from planners.regrasp.graph.handover_ways import HandoverWays
from planners.regrasp.grasps.handovers import HandoverDatabase
from planners.regrasp.motion.travel_time import NodeTravelTimes
from planners.regrasp.statics.static_hold import StaticHold
from planners.regrasp.tool_segment import SuckedObject
from planners.regrasp.tool_settings import CarriedPace
from planners.regrasp.tool_workcell import ToolWorkcell
from planners.scene.tool_scene import SuctionToolScene, build_tool_scene
from tests.kinematics.arm_oracle import PinocchioArm

TASK = Path(__file__).parents[2] / "assets" / "tasks" / "tissue_pile_short_tool.json"
MOST_TILT = 1.0


@pytest.fixture(scope="module")
def scene() -> SuctionToolScene:
    task = read_task(json.loads(TASK.read_text()))
    assert isinstance(task, SuctionToolTask)
    return build_tool_scene(task)


@pytest.fixture(scope="module")
def static_hold(scene: SuctionToolScene) -> StaticHold:
    return StaticHold(scene, 0.1)


@pytest.fixture(scope="module")
def ways(scene: SuctionToolScene, short_handovers: HandoverDatabase, static_hold: StaticHold) -> HandoverWays:
    workcell = ToolWorkcell.of(scene)
    flanges = [short_handovers.grasps.T_tool_flange(workcell.gripper(arm)) for arm in scene.cell.arms]
    travel_times = NodeTravelTimes(list(scene.cell.arms.values()), flanges, CarriedPace())
    park = {name: arm.home for name, arm in scene.cell.arms.items()}
    return HandoverWays(short_handovers, workcell, static_hold, park, travel_times, MOST_TILT)


@pytest.fixture(scope="module")
def sucked(scene: SuctionToolScene) -> SuckedObject:
    return SuckedObject(scene.objects[0].name, transform(position=[0.0, 0.0, -0.03]))


def test_positions_are_those_of_every_branch_that_reaches_the_grasp(
    ways: HandoverWays, short_handovers: HandoverDatabase, scene: SuctionToolScene
) -> None:
    n, rng = len(short_handovers.grasps), np.random.default_rng(1)
    for number, (name, arm) in enumerate(scene.cell.arms.items()):
        chain, flanges = PinocchioArm(arm.dh), short_handovers.grasps.T_tool_flange(ways.workcell.gripper(name))
        there = ways.positions[:, number * n : (number + 1) * n]
        bits = short_handovers.reached(name)[..., None] >> np.arange(8) & 1
        np.testing.assert_array_equal(np.isfinite(there[..., 0]), bits.astype(bool))
        found = np.argwhere(bits)
        for o, grasp, branch in rng.choice(found, min(40, len(found)), replace=False):
            expected = inverse(arm.T_world_base) @ short_handovers.T_world_tool[o] @ flanges[grasp]
            np.testing.assert_allclose(chain.flange_pose(there[o, grasp, branch]), expected, atol=1e-9)


@pytest.mark.parametrize("laden", [False, True])
@pytest.mark.slow
def test_pairs_that_remain_are_borne_by_both_hands_and_the_cup_in_one_orientation(
    ways: HandoverWays, short_handovers: HandoverDatabase, static_hold: StaticHold, sucked: SuckedObject, laden: bool
) -> None:
    load = sucked if laden else None
    to_right, to_left = ways.masks(load)
    base, n = short_handovers, len(short_handovers.grasps)
    borne = static_hold.borne(static_hold.load(load), base.grasps, base.T_world_tool)
    hanging = np.ones(len(base.T_world_tool), dtype=bool)
    if laden:
        tilts = np.arccos(np.clip(base.T_world_tool[:, 2, 2], -1.0, 1.0))
        hanging = static_hold.hanging(static_hold.load(load), base.T_world_tool) & (tilts <= MOST_TILT)
    for left, right in np.random.default_rng(2).integers(0, n, (300, 2)):
        expected = [
            o
            for o in range(len(base.T_world_tool))
            if base.compatible[o, left, right] and borne[o, left] and borne[o, right] and hanging[o]
        ]
        assert ways.meetings(int(left), n + int(right), load).tolist() == expected
        assert ways.meetings(n + int(right), int(left), load).tolist() == expected
        assert to_right[left, right] == to_left[right, left] == bool(expected)
    assert to_right.any()


def test_the_place_with_the_shortest_ways_comes_first(ways: HandoverWays, scene: SuctionToolScene) -> None:
    q = {name: arm.home for name, arm in scene.cell.arms.items()}
    n = len(ways.handovers.grasps)
    left, right = (int(k) for k in np.argwhere(ways.handovers.compatible.sum(axis=0) >= 3)[0])
    giver, receiver = left, n + right
    onward = np.array([scene.cell.arms["right"].home + 0.3])
    for there in (np.empty((0, 6)), onward):
        places = ways.places(q, giver, receiver, None, there)
        numbers = [
            next(o for o, T in enumerate(ways.handovers.T_world_tool) if np.array_equal(T, place.T_world_tool))
            for place in places
        ]
        seconds = []
        for o in numbers:
            give, take = ways.positions[o, giver], ways.positions[o, receiver]
            total = ways.travel_times.of(giver, q["left"][None], give)
            total += ways.travel_times.of(receiver, q["right"][None], take, carries=False)
            seconds.append(total + (ways.travel_times.of(receiver, take, there) if len(there) else 0.0))
        assert sorted(numbers) == ways.meetings(giver, receiver, None).tolist()
        assert seconds == sorted(seconds)
