"""Forces of cup and fingers along made-up motions keep Newton's laws and tell what gives way."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from planners.contract.quantities import SOFT_FINGER_EPS
from planners.contract.task_spec import read_task
from planners.errors import SceneError
from planners.geometry.pose import Array, inverse, rotation_from_vector, transform
from planners.motion.trajectory import Trajectory
from planners.plan.segment import SegmentKind
from planners.regrasp.statics.hold_statics import PRESSED, HoldStatics, UnheldError
from planners.regrasp.tool_segment import ExertedForce, SuckedObject, ToolHold, ToolSegment
from planners.scene.tool_scene import build_tool_scene
from tests.support.tool_plans import block

GRAVITY = 9.81
CUP_FORCE = 20.0
"""Of the shipped long tool [N]."""
ACROSS = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
"""A hand beside the shaft: it approaches along the tool's y and closes along its x."""

STRONG_TOOL = {
    "shapes": [
        {"shape": {"type": "cylinder", "radius": 0.0175, "height": 0.06}, "pose": [0, 0, 0.03, 1, 0, 0, 0]},
        {"shape": {"type": "box", "size": [0.018, 0.018, 0.19]}, "pose": [0, 0, 0.155, 1, 0, 0, 0]},
    ],
    "mass": 0.25, "com": [0, 0, 0.11], "cup": {"radius": 0.0175, "max_force": 100.0},
}  # fmt: skip
PAYLOAD, SENSOR, GRIPPER = 3.0, 0.300, 0.905
"""Of the UR3e; and what is mounted on it, by the makers' data sheets [kg]."""
STRONG = {"left": 1e3, "right": 1e3}


def hold(arm: str, height: float) -> ToolHold:
    return ToolHold(arm, transform(ACROSS, [0.0, 0.0, height]), 0.018, np.eye(4))


def statics(said: dict[str, Any] | None = None, **members: Any) -> HoldStatics:
    """Of a block with these members, and of what the task says besides."""
    task = read_task({"kind": "suction_tool", "objects": [block(**members)], **(said or {})})
    assert task.kind == "suction_tool"
    return HoldStatics(build_tool_scene(task))


def borne_by(limits: dict[str, float], **members: Any) -> HoldStatics:
    """With cup and fingers that hold more than any hand may carry, and hands that may carry so much [N]."""
    scene = statics(said={"tool": STRONG_TOOL, "grip_force_limit": 500.0}, **members).scene
    return HoldStatics(replace(scene, carry_force_limits=limits))


def on_top(held: HoldStatics) -> Array:
    """`T_world_tool` with the cup on the middle of the block."""
    return held.start()["block"] @ transform(None, [0.0, 0.0, 0.01])


def segment(
    held: HoldStatics,
    offsets: Array,
    turns: Array,
    step: float,
    kind: SegmentKind = SegmentKind.TRANSFER,
    **members: Any,
) -> tuple[ToolSegment, dict[str, Array]]:
    """A motion of the tool with the block on its cup: (n, 3) ways and turns from where it is on the block."""
    n = len(offsets)
    ways = [transform(rotation_from_vector(turn), offset) for turn, offset in zip(turns, offsets, strict=True)]
    T_tool = np.array([transform(None, way[:3, 3]) @ on_top(held) @ transform(way[:3, :3]) for way in ways])
    T_tool_block = inverse(on_top(held)) @ held.start()["block"]
    zeros = np.zeros((n, 12))
    time = step * np.arange(n)
    made = ToolSegment(
        kind=kind,
        movers=("left",),
        trajectory=Trajectory(time.astype(np.float64), zeros, zeros, zeros, time.astype(np.float64)),
        widths={arm: np.full(n, 0.018) for arm in ("left", "right")},
        holds=members.get("holds", (hold("left", 0.12),)),
        sucked=SuckedObject("block", T_tool_block),
        body_poses={} if kind is not SegmentKind.TRANSFER else {"tool": T_tool, "block": T_tool @ T_tool_block},
    )
    return made, {**held.start(), "tool": T_tool[0]}


def smooth(n: int) -> Array:
    """(n,) from 0 to 1, at rest at both ends."""
    u = np.linspace(0.0, 1.0, n)
    return u**3 * (10.0 - 15.0 * u + 6.0 * u**2)


def swing(
    held: HoldStatics, step: float = 0.02, way: float = 0.1, turn: float = 0.5
) -> tuple[ToolSegment, dict[str, Array]]:
    """Up, aside and tilted."""
    s = smooth(60)[:, None]
    return segment(held, s * [way, -way, way], s * [turn, 0.0, turn], step)


def still(held: HoldStatics, **members: Any) -> tuple[ToolSegment, dict[str, Array]]:
    n = members.pop("samples", 3)
    return segment(held, np.zeros((n, 3)), np.zeros((n, 3)), 0.02, **members)


def test_every_contact_set_balances_weight_and_inertia() -> None:
    held = statics(com=[0.01, -0.005, 0.002])
    swung, places = swing(held)
    masses = {"block": (0.1, [0.01, -0.005, 0.002]), "tool": (held.scene.tool.mass, held.scene.tool.com)}
    found = held.sets(swung, places)
    assert {one.body for one in found} == {"block", "tool"}
    for one in found:
        mass, com = masses[one.body]
        T = swung.body_poses[one.body][one.sample]
        centre = T[:3, :3] @ com + T[:3, 3]
        force = sum(each.wrench[:3] for each in one.forces)
        moment = sum(each.wrench[3:] + np.cross(each.point - centre, each.wrench[:3]) for each in one.forces)
        assert force == pytest.approx([0.0, 0.0, mass * GRAVITY], abs=1e-9)
        assert moment == pytest.approx(np.zeros(3), abs=1e-9)


def test_what_the_tool_exerts_on_the_object_comes_back_to_it() -> None:
    held = statics()
    found = held.sets(*swing(held))
    suction = {(one.sample, one.body): each for one in found for each in one.forces if each.kind == "suction"}
    samples = {sample for sample, _ in suction}
    assert samples
    for sample in samples:
        assert suction[sample, "block"].wrench == pytest.approx(-suction[sample, "tool"].wrench)


def test_sets_are_as_close_as_the_document_demands() -> None:
    held = statics()
    swung, places = swing(held, way=0.15, turn=1.0)
    samples = sorted({one.sample for one in held.sets(swung, places) if one.body == "block"})
    poses = swung.body_poses["block"]
    assert (samples[0], samples[-1]) == (0, len(poses) - 1)
    for one, other in pairwise(samples):
        if other - one == 1:
            continue
        cosine = 0.5 * (np.trace(poses[one, :3, :3].T @ poses[other, :3, :3]) - 1.0)
        assert np.arccos(np.clip(cosine, -1.0, 1.0)) <= np.radians(2.0)
        assert np.linalg.norm(poses[other, :3, 3] - poses[one, :3, 3]) <= 0.010
        assert swung.trajectory.time[other] - swung.trajectory.time[one] <= 0.25


@pytest.mark.parametrize("step", [0.004, 0.006])
def test_between_two_sets_the_mean_of_both_counts_the_inertia(step: float) -> None:
    held = statics()
    swung, places = swing(held, step=step, way=0.005, turn=0.0)
    found = {one.sample: one for one in held.sets(swung, places) if one.body == "block"}
    samples = sorted(found)
    counted = [
        sum((each.wrench[:3] for each in found[sample].forces if each.kind == "inertia"), np.zeros(3))
        for sample in samples
    ]
    centres = swung.body_poses["block"][:, :3, 3]
    needed = -0.1 * np.diff(centres, n=2, axis=0) / step**2
    inner = np.arange(1, len(centres) - 1)
    shown = np.column_stack([np.interp(inner, samples, column) for column in np.array(counted).T])
    assert len(samples) < len(centres)
    assert np.linalg.norm(shown - needed, axis=1).max() <= 0.05 * 0.1 * GRAVITY


def test_a_way_there_and_back_needs_sets_like_any_other() -> None:
    held = statics()
    s = np.concatenate([smooth(40), smooth(40)[-2::-1]])[:, None]
    there_and_back = segment(held, s * [0.0, 0.009, 0.0], np.zeros((len(s), 3)), 0.003)
    samples = sorted({one.sample for one in held.sets(*there_and_back)})
    centres = there_and_back[0].body_poses["block"][:, :3, 3]
    ways = np.linalg.norm(np.diff(centres, axis=0), axis=1)
    assert all(ways[one:other].sum() <= 0.010 for one, other in pairwise(samples))


@pytest.mark.parametrize("mass", [0.1, 0.5, 1.9])
def test_an_object_that_hangs_still_leaves_the_cup_what_it_does_not_weigh(mass: float) -> None:
    held = statics(mass=mass)
    worst = held.worst(*still(held))
    assert worst.margin <= 1.0 - mass * GRAVITY / CUP_FORCE + 1e-9


def test_a_cup_holds_up_to_its_force_and_no_more() -> None:
    limit = CUP_FORCE / GRAVITY

    def carried_by_strong_arms(mass: float) -> HoldStatics:
        return HoldStatics(replace(statics(mass=mass).scene, carry_force_limits=STRONG))

    assert carried_by_strong_arms(0.99 * limit).worst(*still(statics(mass=0.99 * limit))).rejection is None
    rejection = carried_by_strong_arms(1.01 * limit).worst(*still(statics(mass=1.01 * limit))).rejection
    assert rejection is not None
    assert (rejection.stage, "block" in str(rejection.where)) == ("suction", True)


def test_a_hand_carries_what_the_payload_leaves_beside_it_and_no_more() -> None:
    left = PAYLOAD - SENSOR - GRIPPER
    light, heavy = (
        statics(said={"tool": STRONG_TOOL}, mass=share * left - STRONG_TOOL["mass"]) for share in (0.999, 1.001)
    )
    assert light.worst(*still(light)).rejection is None
    rejection = heavy.worst(*still(heavy)).rejection
    assert rejection is not None
    assert "payload" in rejection.reason
    assert "left hand" in rejection.where
    assert (rejection.needed, rejection.available) == pytest.approx((1.001 * left * GRAVITY, left * GRAVITY))


def test_a_task_may_let_a_hand_carry_less_and_never_more() -> None:
    left = (PAYLOAD - SENSOR - GRIPPER) * GRAVITY
    assert statics(said={"carry_force_limit": 100.0}).scene.carry_force_limits == pytest.approx(
        dict.fromkeys(STRONG, left)
    )
    needed = (0.1 + 0.25) * GRAVITY
    for limit, held in ((1.01 * needed, True), (0.99 * needed, False)):
        limited = statics(said={"carry_force_limit": limit})
        assert (limited.worst(*still(limited)).rejection is None) == held


def test_a_motion_is_slowed_until_its_inertia_is_within_what_a_hand_may_carry() -> None:
    held = borne_by({"left": 12.0, "right": 12.0}, mass=0.9)
    fast, places = swing(held, step=0.004, way=0.15, turn=0.1)
    rejection = held.worst(fast, places).rejection
    assert rejection is not None
    assert rejection.stage == "carry"
    slowness = held.stretch(fast, places)
    assert slowness is not None
    slow, places = swing(held, step=0.004 * slowness, way=0.15, turn=0.1)
    assert held.worst(slow, places).margin >= 0.0
    assert max(nets(held, slow, places)["left"]) <= 12.0


def test_sets_of_what_does_not_hold_are_an_error_that_says_so() -> None:
    held = statics(mass=3.0)
    with pytest.raises(UnheldError, match="payload"):
        held.sets(*still(held))


def test_a_stretched_motion_holds_with_its_inertia_twice_and_a_little_less_does_not() -> None:
    held = statics(mass=1.2)
    fast, places = swing(held, step=0.004, way=0.15, turn=0.1)
    slowest = held.worst(*swing(held, step=4.0, way=0.15, turn=0.1))
    assert held.worst(fast, places).margin < 0.0 <= slowest.margin
    slowness = held.stretch(fast, places)
    assert slowness is not None
    assert slowness > 1.0
    # A motion in so much less time has twice the inertia.
    sudden = 0.004 * slowness / math.sqrt(2.0)
    assert held.worst(*swing(held, step=sudden, way=0.15, turn=0.1)).margin >= 0.0
    assert held.worst(*swing(held, step=0.97 * sudden, way=0.15, turn=0.1)).margin < 0.0


def passed(along: ToolSegment, time: Array) -> ToolSegment:
    """Return a segment with its samples at other times."""
    return replace(along, trajectory=replace(along.trajectory, time=time))


def test_a_path_that_is_passed_evenly_and_as_fast_as_is_borne_holds_and_faster_does_not() -> None:
    held = statics(mass=1.2)
    along, places = swing(held, step=0.01, way=0.15, turn=0.1)
    borne = held.borne_rates(along, places, 20.0, 20.0)
    assert borne is not None
    # Twice the inertia is allowed for.
    fastest = math.sqrt(2.0 * borne.squared_speed.min())
    assert held.worst(passed(along, borne.parameter / fastest), places).margin == pytest.approx(0.0, abs=1e-3)
    assert held.worst(passed(along, borne.parameter / (1.02 * fastest)), places).margin < -1e-3


@pytest.mark.parametrize("backwards", [False, True])
def test_a_path_on_which_speed_is_gained_as_fast_as_is_borne_holds(backwards: bool) -> None:
    held = statics(mass=1.2)
    along, places = swing(held, step=0.01, way=0.15, turn=0.1)
    borne = held.borne_rates(along, places, 20.0, 20.0)
    assert borne is not None
    s = borne.parameter[-1] - borne.parameter[::-1] if backwards else borne.parameter
    bound = np.min(1.0 / (1.0 / borne.rate + 2.0 * (s[-1] - s if backwards else s) / borne.squared_speed))
    for share, holds in ((1.0, True), (4.0, False)):
        time = np.sqrt(2.0 * s / (share * 2.0 * bound))
        time = time[-1] - time[::-1] if backwards else time
        worst = held.worst(passed(along, time), places)
        assert (worst.margin >= -1e-2) == holds


def test_a_motion_that_holds_is_not_stretched_and_one_that_never_holds_is_given_up() -> None:
    light, heavy = statics(), statics(mass=3.0)
    assert light.stretch(*swing(light)) == 1.0
    assert heavy.stretch(*swing(heavy)) is None


def test_a_reserve_is_kept() -> None:
    held = statics(mass=1.0)
    fast, places = swing(held, step=0.004, turn=0.0)
    assert held.worst(fast, places).margin < 0.3
    slowness = HoldStatics(held.scene.keeping_back(0.3)).stretch(fast, places)
    assert slowness is not None
    sudden = 0.004 * slowness / math.sqrt(2.0)
    assert held.worst(*swing(held, step=sudden, turn=0.0)).margin >= 0.3
    assert held.worst(*swing(held, step=0.97 * sudden, turn=0.0)).margin < 0.3


@pytest.mark.parametrize(
    ("members", "strong"),
    [({"mass": 1.0}, False), ({"mass": 0.3, "com": [0.03, 0.02, 0.0]}, False), ({"mass": 1.2}, True)],
)
def test_limits_that_are_smaller_by_the_reserve_are_just_kept(members: dict[str, Any], strong: bool) -> None:
    """At every sample of a motion, with one hand and with two."""
    held = borne_by({"left": 30.0, "right": 40.0}, **members) if strong else statics(**members)
    swung, places = swing(held, step=0.015, turn=0.2)
    both, _ = still(held, holds=(hold("left", 0.10), hold("right", 0.18)))
    for made in (swung, both):
        found = held.balanced([made])[0].reserve
        assert found is not None
        assert found.least == pytest.approx(held.worst(made, places).margin)
        assert 0.0 < found.least == found.values.min() < 1.0
        for share, holds in ((found.least - 1e-6, True), (found.least + 1e-6, False)):
            weaker = HoldStatics(held.scene.keeping_back(share))
            assert (weaker.worst(made, places).margin >= 0.0) == holds
            if holds:
                weakest = weaker.balanced([made])[0].reserve
                assert weakest is not None
                assert weakest.limited_by == found.limited_by
        assert found.body == ("block" if found.limited_by.startswith("cup") else "tool")


def test_the_squeeze_is_the_largest_with_which_no_finger_presses_too_hard() -> None:
    spare = (PAYLOAD - SENSOR - GRIPPER) * GRAVITY
    for limit, squeeze in ((60.0, 60.0 - 0.5 * spare), (25.0, 20.0), (500.0, 235.0)):
        scene = statics(said={"grip_force_limit": limit}).scene
        assert scene.squeeze == pytest.approx(squeeze)
        for arm in ("left", "right"):
            assert scene.finger_limit(arm) == pytest.approx(min(limit, squeeze + 0.5 * spare))
        assert scene.keeping_back(0.4).squeeze == scene.squeeze
    with pytest.raises(SceneError, match="20 N at least") as refused:
        statics(said={"grip_force_limit": 19.9})
    assert refused.value.pointer == "/grip_force_limit"


def test_fingers_of_a_weak_grip_press_no_harder_than_their_limit() -> None:
    """Along the closing axis a finger bears half of the load more: 2.5 N and a squeeze of 20 N are more than 22 N."""
    lying = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
    for limit, held_at_all in ((22.0, False), (23.0, True)):
        held = statics(said={"grip_force_limit": limit, "tool": STRONG_TOOL}, mass=5.0 / GRAVITY - 0.25)
        level = ToolHold("left", transform(lying, [0.0, 0.0, 0.11]), 0.018, np.eye(4))
        made, places = still(held, holds=(level,))
        up = np.array([[0.0, 0.0, 1.0]])
        assert np.abs(made.body_poses["tool"][0, :3, :3] @ lying[:, 1]) == pytest.approx(np.abs(up[0]))
        rejection = held.worst(made, places).rejection
        assert (rejection is None) == held_at_all
        assert rejection is None or (rejection.stage, rejection.reason) == ("grip", PRESSED)


def nets(held: HoldStatics, made: ToolSegment, places: dict[str, Array]) -> dict[str, list[float]]:
    """What each hand exerts on the tool in all, at every contact set [N]."""
    found: dict[str, list[float]] = {}
    for one in held.sets(made, places):
        fingers = [f for f in one.forces if f.kind == "soft_finger"]
        for arm in {f.by for f in fingers}:
            net = np.sum([f.wrench[:3] for f in fingers if f.by == arm], axis=0)
            found.setdefault(arm, []).append(float(np.linalg.norm(net)))
    return found


@pytest.mark.parametrize("weaker", ["left", "right"])
def test_two_hands_that_carry_together_share_the_load_by_what_each_may_carry(weaker: str) -> None:
    weight = (2.0 + 0.25) * GRAVITY
    limits = {"left": 0.8 * weight, "right": 0.8 * weight, weaker: 0.3 * weight}
    held = borne_by(limits, mass=2.0)
    one, places = still(held)
    assert held.worst(one, places).rejection is not None
    both, _ = still(held, holds=(hold("left", 0.10), hold("right", 0.18)))
    assert held.worst(both, places).margin == pytest.approx(1.0 - 1.0 / 1.1)
    for arm, borne in nets(held, both, places).items():
        assert borne == pytest.approx([limits[arm] / 1.1] * len(borne))


def test_two_hands_use_their_friction_alike_and_less_than_one_where_they_may_carry_more() -> None:
    held = borne_by(STRONG, mass=1.0)
    friction = held.scene.friction.grip
    one, places = still(held)
    both, _ = still(held, holds=(hold("left", 0.10), hold("right", 0.18)))

    def used(force: ExertedForce) -> float:
        pressed = float(force.wrench[:3] @ force.normal)
        across = np.linalg.norm(force.wrench[:3] - pressed * force.normal)
        return float(np.hypot(across, force.wrench[3:] @ force.normal / SOFT_FINGER_EPS) / (friction * pressed))

    def most(made: ToolSegment) -> list[float]:
        forces = [f for s in held.sets(made, places) if s.body == "tool" and s.sample == 0 for f in s.forces]
        arms = sorted({f.by for f in forces if f.kind == "soft_finger"})
        return [max(used(f) for f in forces if f.by == arm) for arm in arms]

    (alone,), (left, right) = most(one), most(both)
    assert left == pytest.approx(right, rel=1e-6)
    assert left < alone


@pytest.mark.parametrize("kind", [SegmentKind.ATTACH, SegmentKind.DETACH])
def test_while_the_vacuum_goes_on_or_off_the_table_carries_the_object(kind: SegmentKind) -> None:
    held = statics()
    made, places = still(held, kind=kind)
    for one in held.sets(made, places):
        if one.body == "block":
            carried = [each for each in one.forces if each.kind == "environment"]
            assert {each.by for each in carried} == {"table"}
            assert sum(each.wrench[2] for each in carried) == pytest.approx(0.1 * GRAVITY)
            assert [each.wrench.any() for each in one.forces if each.kind == "suction"] == [False]


def test_an_object_is_not_let_go_of_in_the_air() -> None:
    held = statics()
    made, places = still(held, kind=SegmentKind.DETACH)
    places["block"] = transform(None, [0.0, 0.0, 0.05]) @ places["block"]
    rejection = held.worst(made, places).rejection
    assert rejection is not None
    assert rejection.where == "block"


def test_where_no_hand_bears_the_tool_nothing_is_asked() -> None:
    held = statics()
    made, places = still(held, holds=())
    assert held.sets(made, places) == ()
    assert held.worst(made, places).margin == np.inf
