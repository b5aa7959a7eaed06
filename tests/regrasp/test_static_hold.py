"""Yes or no of cup and fingers against the margins of `suction_hold` and the friction of `finger_forces`."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from planners.contract.quantities import SOFT_FINGER_EPS
from planners.contract.task_spec import SuctionToolTask, read_task
from planners.geometry.pose import Array, inverse, transform
from planners.geometry.wrench import wrench_about
from planners.regrasp.grasps.tool_grasps import ToolGrasps
from planners.regrasp.statics.finger_forces import squeezed
from planners.regrasp.statics.static_hold import CarryingHand, StaticHold
from planners.regrasp.suction.suction_hold import cup_wrenches, suction_margins, weight
from planners.regrasp.tool_segment import SuckedObject
from planners.scene.tool_scene import SuctionToolScene, build_tool_scene

TASK = Path(__file__).parents[2] / "assets" / "tasks" / "tissue_pile.json"
OFF_CENTRE = transform(Rotation.from_euler("z", 0.4).as_matrix(), [0.012, -0.02, -0.03])


@pytest.fixture(scope="module")
def scene() -> SuctionToolScene:
    task = read_task(json.loads(TASK.read_text()))
    assert isinstance(task, SuctionToolTask)
    return build_tool_scene(task)


@pytest.fixture(scope="module")
def poses() -> Array:
    rng = np.random.default_rng(4)
    return np.array([transform(R, [0.4, 0.0, 1.5]) for R in Rotation.random(60, rng=rng).as_matrix()])


def test_the_cup_bears_where_no_margin_is_negative(scene: SuctionToolScene, poses: Array) -> None:
    sucked, body = SuckedObject(scene.objects[0].name, OFF_CENTRE), scene.objects[0].body
    assert body.mass is not None
    tilted = np.concatenate([poses, poses[:, :, [1, 0, 2, 3]] * [1, 1, -1, 1]])
    wrenches = cup_wrenches(
        weight(body.mass, np.array([0.0, 0.0, -9.81])), tilted @ OFF_CENTRE, body.com, inverse(OFF_CENTRE)
    )
    static_hold = StaticHold(scene, 0.0)
    expected = suction_margins(wrenches, scene.tool.cup).min(axis=1) >= 0.0
    assert expected.any()
    assert not expected.all()
    np.testing.assert_array_equal(static_hold.hanging(static_hold.load(sucked), tilted), expected)


@pytest.mark.parametrize("reserve", [0.0, 0.5, 0.8])
def test_fingers_bear_where_they_do_not_slip_with_what_friction_is_not_kept_back(
    scene: SuctionToolScene, poses: Array, long_grasps: ToolGrasps, reserve: float
) -> None:
    sucked, body = SuckedObject(scene.objects[0].name, OFF_CENTRE), scene.objects[0].body
    static_hold = StaticHold(scene, reserve)
    borne = static_hold.borne(static_hold.load(sucked), long_grasps, poses)
    tool = scene.tool
    needed = []
    for T in poses:
        up = np.array([0.0, 0.0, 9.81, 0.0, 0.0, 0.0])
        centres = [T[:3, :3] @ tool.com + T[:3, 3], (T @ OFF_CENTRE)[:3, :3] @ body.com + (T @ OFF_CENTRE)[:3, 3]]
        masses = [tool.mass, body.mass or 0.0]
        total = sum(wrench_about(m * up, c, np.zeros(3)) for m, c in zip(masses, centres, strict=True))
        for T_tool_tcp, width in zip(long_grasps.T_tool_tcp, long_grasps.widths, strict=True):
            tcp = T @ T_tool_tcp
            about = wrench_about(total, np.zeros(3), tcp[:3, 3])
            local = np.concatenate([tcp[:3, :3].T @ about[:3], tcp[:3, :3].T @ about[3:]])
            needed.append((local, float(width)))
    used = np.empty(len(needed))
    widths = np.array([width for _, width in needed])
    wrenches = np.array([wrench for wrench, _ in needed])
    for width in np.unique(widths):
        rows = widths == width
        used[rows] = squeezed(wrenches[rows], float(width), scene.friction.grip, SOFT_FINGER_EPS, scene.squeeze).slip
    clear = np.abs(used - (1.0 - reserve)) > 1e-6
    np.testing.assert_array_equal(borne.ravel()[clear], (used <= 1.0 - reserve)[clear])
    assert 0 < borne.sum() < borne.size


@pytest.mark.parametrize("squeeze", [15.0, 30.0, 60.0])
def test_fingers_bear_in_just_the_grasps_whose_least_squeeze_is_no_more_than_theirs(
    scene: SuctionToolScene, poses: Array, long_grasps: ToolGrasps, squeeze: float
) -> None:
    static_hold = StaticHold(scene, 0.5)
    load = static_hold.load(SuckedObject(scene.objects[0].name, OFF_CENTRE))
    least = np.array([static_hold.least_squeezes(load, long_grasps, T) for T in poses])
    # However hard a finger presses with what it bears beyond the squeeze.
    borne = static_hold.borne(
        load._replace(fingers=np.array([squeeze, 1e3, *load.fingers[2:]])), long_grasps, np.ascontiguousarray(poses)
    )
    clear = np.abs(least - squeeze) > 1e-6
    assert clear.mean() > 0.9
    np.testing.assert_array_equal(borne[clear], (least <= squeeze)[clear])
    assert len(np.unique(borne)) == 2


def test_only_arms_whose_payload_is_left_carry_a_load_at_rest(scene: SuctionToolScene) -> None:
    sucked, body = SuckedObject(scene.objects[0].name, OFF_CENTRE), scene.objects[0].body
    empty, laden = scene.tool.mass * 9.81, (scene.tool.mass + (body.mass or 0.0)) * 9.81
    for left, right in ((empty + 1e-6, laden + 1e-6), (empty - 1e-6, laden - 1e-6)):
        static_hold = StaticHold(replace(scene, carry_force_limits={"left": left, "right": right}), 0.0)
        assert static_hold.carried(static_hold.load(None)) == {"left": left > empty, "right": True}
        assert static_hold.carried(static_hold.load(sucked)) == {"left": False, "right": right > laden}


def test_an_edge_is_borne_if_all_its_places_are(scene: SuctionToolScene, long_grasps: ToolGrasps) -> None:
    """The load is borne along an edge just where every pose of the tool on it is, asked one by one."""
    rng, static_hold, arm = np.random.default_rng(7), StaticHold(scene, 0.5), scene.cell.arms["left"]
    load = static_hold.load(SuckedObject(scene.objects[0].name, OFF_CENTRE))
    grasp = 0
    T_tool_flange = long_grasps.T_tool_flange(arm.hand)[grasp]  # type: ignore[arg-type]
    hand = CarryingHand(
        arm, inverse(T_tool_flange), long_grasps.T_tool_tcp[grasp], float(long_grasps.widths[grasp]), load
    )
    answers = set()
    for _ in range(300):
        q = rng.uniform(-np.pi, np.pi, 6)
        other = q + rng.uniform(-0.4, 0.4, 6)
        whole = hand.bears(q, other, 0.05, -1.0)
        parts = np.linspace(0.0, 1.0, 2 + int(np.ceil(np.abs(other - q).max() / 0.05)))
        places = q + parts[:, None] * (other - q)
        assert whole == all(hand.bears(place, place, 0.05, -1.0) for place in places)
        answers.add(whole)
    assert answers == {True, False}
