"""Which grasps an arm reaches, with pinocchio's kinematics and python-fcl's distances as the authorities."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest

from planners.collision.model import Fixed, Riding
from planners.contract.shapes import Box
from planners.geometry.convex import CollisionBody
from planners.geometry.pose import inverse, rotation_x, rotation_z, transform
from planners.kinematics.inverse import follow_branch
from planners.regrasp.grasps.grasp_reach import GraspReach, GraspSurroundings
from planners.regrasp.grasps.tool_grasps import ToolGrasps, ToolGraspSettings
from planners.regrasp.motion.travel_time import solutions
from planners.regrasp.tool_workcell import ToolWorkcell
from planners.scene.body import Body
from planners.scene.solid import solid_of
from tests.cell.cell_probe import fcl_distance, fcl_object
from tests.kinematics.arm_oracle import PinocchioArm
from tests.regrasp.hand_oracle import NEAR, ToolCell

SETTINGS = ToolGraspSettings()
TURN = 2.0 * np.pi
UP = np.array([0.0, 0.0, 0.05])


def standing(x: float, y: float, above: float = 0.05, yaw: float = 0.0) -> np.ndarray:
    return transform(rotation_z(yaw), [x, y, 1.094 + above])


def reach_of(workcell: ToolWorkcell, arm: str, grasps: ToolGrasps, objects=None) -> GraspReach:
    other = workcell.arm(workcell.other(arm))
    return GraspReach(workcell, arm, grasps, GraspSurroundings(objects or {}, other.home, 0.085))


@pytest.fixture(scope="module", params=["left", "right"])
def reach(request, long_workcell, long_grasps):
    return reach_of(long_workcell, request.param, long_grasps)


PLACES = {
    "middle": (standing(0.38, 0.02, yaw=0.7), UP),
    "lying": (transform(rotation_x(0.5 * np.pi), [0.35, 0.0, 1.3]), None),
    "high": (standing(0.35, 0.1, 0.25), np.array([0.03, -0.02, 0.04])),
}


def ways(reach: GraspReach, T_world_tool: np.ndarray, grasp: int, lift: np.ndarray | None, step: float):
    """The flange and the tool on the way back from a grasp, then on the lift: poses evenly apart, the grasp first."""
    T_tool_tcp, width = reach.grasps.T_tool_tcp[grasp], float(reach.grasps.widths[grasp])
    T_tool_flange = T_tool_tcp @ inverse(reach.workcell.gripper(reach.arm).T_flange_tcp(width))
    back = [T_tool_flange @ transform(None, [0, 0, -s]) for s in np.arange(0.0, SETTINGS.approach + 1e-9, step)]
    approach = [(T_world_tool, T_world_tool @ T) for T in back]
    way = np.zeros(3) if lift is None else lift
    count = int(np.ceil(np.linalg.norm(way) / step))
    tools = [transform(None, k / max(count, 1) * way) @ T_world_tool for k in range(count + 1)]
    return approach, [(T, T @ T_tool_flange) for T in tools]


def follow(reach: GraspReach, poses, branch: int) -> np.ndarray:
    arm = reach.workcell.arm(reach.arm)
    flanges = np.array([T for _, T in poses])
    return follow_branch(arm.dh, inverse(arm.T_world_base), flanges, branch, np.empty((0, 6)))


def in_one_winding(reach: GraspReach, rows: np.ndarray) -> bool:
    arm = reach.workcell.arm(reach.arm)
    turned = rows + TURN * np.array([-1, 0, 1])[:, None, None]
    return bool(((turned >= arm.position_min) & (turned <= arm.position_max)).all(axis=1).any(axis=0).all())


def with_idle(reach: GraspReach, q: np.ndarray) -> np.ndarray:
    other = reach.workcell.other(reach.arm)
    positions = np.empty(12)
    positions[reach.workcell.joints(reach.arm)] = q
    positions[reach.workcell.joints(other)] = reach.workcell.arm(other).home
    return positions


def slack_of(reach: GraspReach, approach, lifted, grasp: int, branch: int, margin: float, first: float) -> float:
    """The least slack on both ways: approached with open fingers, lifted with closed ones; none left is a collision."""
    cell, arm = ToolCell(reach.workcell), reach.arm
    other = reach.workcell.other(arm)
    closed, opened = float(reach.grasps.widths[grasp]), float(reach.grasps.open_widths[grasp])

    def own(a, b):
        return arm in (a.group, b.group)

    def carried(a, b):
        return own(a, b) or ("tool" in (a.group, b.group) and "cell" in (a.group, b.group))

    slack = 1.0
    for (T_world_tool, _), q in zip(approach, follow(reach, approach, branch), strict=True):
        q12, widths = with_idle(reach, q), {arm: opened, other: 0.085}
        slack = min(slack, cell.least_slack(q12, T_world_tool, widths, own, margin=margin))
        if slack < first:
            return slack
    for k, ((T_world_tool, _), q) in enumerate(zip(lifted, follow(reach, lifted, branch), strict=True)):
        q12, widths = with_idle(reach, q), {arm: closed, other: 0.085}
        pairs = own if k == 0 else carried
        slack = min(slack, cell.least_slack(q12, T_world_tool, widths, pairs, holding=(arm,), margin=margin))
        if slack < first:
            return slack
    return slack


@pytest.mark.parametrize("place", ["middle", "lying"])
def test_a_branch_reaches_a_grasp_exactly_when_its_ways_are_free_and_within_limits(reach, place):
    T_world_tool, lift = PLACES[place]
    reached = reach.branches(T_world_tool, lift)
    rng = np.random.default_rng(7)
    asked = [(rng.permutation(np.flatnonzero(reached))[0], b) for b in range(8)]
    asked += [(g, b) for g in rng.permutation(len(reach.grasps))[:6] for b in rng.permutation(8)[:3]]
    verdicts = []
    for grasp, branch in asked:
        approach, lifted = ways(reach, T_world_tool, grasp, lift, SETTINGS.step)
        if lift is not None:
            count = int(np.ceil(np.linalg.norm(lift) / SETTINGS.step))
            assert len(lifted) == count + 1
        there = follow(reach, approach, branch), follow(reach, lifted, branch)
        free = bool(np.isfinite(np.vstack(there)).all())
        free = free and all(np.abs(np.diff(rows, axis=0)).max(initial=0.0) < 0.25 for rows in there)
        free = free and in_one_winding(reach, np.vstack(there))
        if free:
            slack = slack_of(reach, approach, lifted, grasp, branch, 0.003, 0.0)
            if abs(slack) < NEAR:
                continue
            free = slack > 0.0
        verdicts.append(free)
        assert free == bool(reached[grasp] >> branch & 1), (grasp, branch)
    assert any(verdicts)
    assert not all(verdicts)


def test_a_solution_puts_the_pads_where_the_grasp_says(reach):
    """Authority: pinocchio, and the gripper's table of openings."""
    T_world_tool, lift = PLACES["middle"]
    reached = reach.branches(T_world_tool, lift)
    arm = reach.workcell.arm(reach.arm)
    for grasp in np.flatnonzero(reached)[::9]:
        for branch in (b for b in range(8) if reached[grasp] >> b & 1):
            only = np.array([1 << branch], np.uint8)
            q = solutions(arm, T_world_tool, reach.T_tool_flange[grasp : grasp + 1], only)[0, branch]
            T_world_flange = arm.T_world_base @ PinocchioArm(arm.dh).flange_pose(q)
            height = np.interp(reach.grasps.widths[grasp], *reach.workcell.gripper(reach.arm).tcp_table.T)
            T_world_tcp = T_world_flange @ transform(None, [0, 0, height])
            assert T_world_tcp == pytest.approx(T_world_tool @ reach.grasps.T_tool_tcp[grasp], abs=1e-5)


def test_nothing_touches_between_the_checked_places_either(reach):
    T_world_tool, lift = PLACES["middle"]
    reached = reach.branches(T_world_tool, lift)
    for grasp in np.random.default_rng(8).permutation(np.flatnonzero(reached))[:2]:
        branch = int(reached[grasp]).bit_length() - 1
        approach, lifted = ways(reach, T_world_tool, grasp, lift, 0.0025)
        assert slack_of(reach, approach, lifted, grasp, branch, 0.0, 0.0) > 0.0


def test_what_one_arm_reaches_the_other_reaches_in_the_mirror(cell, long_workcell, long_grasps):
    """The cell and the tool are mirror images of themselves; a hand is, too, but for the names of its fingers."""
    mirror, swap = np.diag([1.0, -1.0, 1.0, 1.0]), np.diag([1.0, -1.0, 1.0, 1.0])
    mirrored = replace(long_grasps, T_tool_tcp=mirror @ long_grasps.T_tool_tcp @ swap)
    agree = []
    for T_world_tool, lift in PLACES.values():
        across = None if lift is None else mirror[:3, :3] @ lift
        left = reach_of(long_workcell, "left", long_grasps).branches(T_world_tool, lift)
        right = reach_of(long_workcell, "right", mirrored).branches(mirror @ T_world_tool @ mirror, across)
        assert (left > 0).sum() > 20
        agree += list(np.bitwise_count(left) == np.bitwise_count(right))
    # The two arms' links are the same mesh, which is not quite its own mirror image.
    assert np.mean(agree) > 0.97


def test_a_lift_only_takes_branches_away_and_chosen_grasps_are_judged_as_among_all(reach):
    T_world_tool, lift = PLACES["middle"]
    without, with_lift = reach.branches(T_world_tool), reach.branches(T_world_tool, lift)
    assert not (with_lift & ~without).any()
    chosen = np.arange(0, len(reach.grasps), 7)
    some = reach.branches(T_world_tool, lift, chosen)
    assert np.array_equal(some[chosen], with_lift[chosen])
    some[chosen] = 0
    assert not some.any()


def test_a_tool_that_goes_down_into_the_table_is_reached_by_nobody(reach):
    T_world_tool = standing(0.38, 0.0, 0.01)
    assert reach.branches(T_world_tool).any()
    assert not reach.branches(T_world_tool, np.array([0.0, 0.0, -0.02])).any()


def test_an_object_on_the_cup_is_carried_along_and_one_beside_it_is_in_the_way(cell, long_tool, long_grasps):
    body = block_of(0.13, 0.07, 0.02)
    workcell = ToolWorkcell(cell, long_tool, (body,))
    T_world_tool = standing(0.38, 0.0, 0.0235)
    T_tool_block = transform(None, [0.0, 0.0, -0.01])
    free = reach_of(workcell, "left", long_grasps, {"block": None}).branches(T_world_tool, UP)
    sucked = reach_of(workcell, "left", long_grasps, {"block": Riding("tool", T_tool_block)}).branches(T_world_tool, UP)
    beside = transform(None, [0.0, 0.06, 0.10])
    blocked = reach_of(workcell, "left", long_grasps, {"block": Fixed(T_world_tool @ beside)}).branches(
        T_world_tool, UP
    )
    assert free.any()
    assert sucked.any()
    assert not (sucked & ~free).any()
    assert (blocked > 0).sum() < (free > 0).sum()
    low = T_world_tool.copy()
    low[2, 3] -= 0.03
    # With the block inside the table the lift begins in a collision.
    inside = reach_of(workcell, "left", long_grasps, {"block": Riding("tool", T_tool_block)})
    assert not inside.branches(low, UP).any()


CUBE = 0.006


def cube_slacks(gripper, width: float, opened: float, offset: np.ndarray) -> tuple[float, float, float]:
    """How far a cube off the flange is from the closed hand, the open one, and that on its way, less the margin."""
    shape = CollisionBody("cube", "cube", "cube", block_of(CUBE).solid.convex_parts)
    cube = fcl_object(shape, transform(None, offset))

    def slack(hand_width: float, back: float) -> float:
        T = transform(None, [0.0, 0.0, -back])
        hand = (fcl_object(part, T) for part in gripper.bodies("left", hand_width))
        return min(fcl_distance(part, cube) for part in hand) - 0.003

    return slack(width, 0.0), slack(opened, 0.0), min(slack(opened, back) for back in SETTINGS.way())


def block_of(*size: float) -> Body:
    shape = Box(type="box", size=size if len(size) == 3 else size * 3)
    return Body("block", "object", shape, solid_of(shape), 0.1, np.zeros(3), np.eye(4), static=False)


@pytest.mark.parametrize(
    ("side", "height", "when"),
    [(1, 0.175, "open"), (-1, 0.175, "open"), (1, 0.03, "way")],
)
@pytest.mark.slow
def test_a_cube_that_only_the_open_or_the_coming_hand_would_meet_forbids_a_grasp(
    cell, gripper, long_tool, long_grasps, side, height, when
):
    workcell, (T_world_tool, lift) = ToolWorkcell(cell, long_tool, (block_of(CUBE),)), PLACES["middle"]
    reached = reach_of(workcell, "left", long_grasps, {"block": None}).branches(T_world_tool, lift)
    for grasp in np.random.default_rng(13).permutation(np.flatnonzero(reached))[:4]:
        width, opened = float(long_grasps.widths[grasp]), float(long_grasps.open_widths[grasp])
        for y in np.arange(0.02, 0.09, 0.001):
            offset = np.array([0.0, side * y, height])
            closed, still, way = cube_slacks(gripper, width, opened, offset)
            if closed > NEAR and ((still < -NEAR) if when == "open" else (still > NEAR and way < -NEAR)):
                break
        else:
            pytest.fail("there is no such place")
        T_tool_flange = long_grasps.T_tool_tcp[grasp] @ inverse(gripper.T_flange_tcp(width))
        cube = {"block": Fixed(T_world_tool @ T_tool_flange @ transform(None, offset))}
        assert not reach_of(workcell, "left", long_grasps, cube).branches(T_world_tool, lift, np.array([grasp])).any()


def test_narrower_limits_leave_the_branches_that_have_one_winding_within_them(cell, long_tool, long_grasps):
    narrow = np.radians([100.0, 170.0, 150.0, 130.0, 100.0, 120.0])
    arms = {
        name: replace(arm, robot=replace(arm.robot, position_min=-narrow, position_max=narrow + 0.3))
        for name, arm in cell.arms.items()
    }
    narrow_workcell = ToolWorkcell(replace(cell, arms=arms), long_tool)
    T_world_tool, lift = PLACES["middle"]
    wide = reach_of(ToolWorkcell(cell, long_tool), "left", long_grasps)
    limited = reach_of(narrow_workcell, "left", long_grasps)
    reached, left = wide.branches(T_world_tool, lift), limited.branches(T_world_tool, lift)
    expected = np.zeros_like(reached)
    for grasp in np.flatnonzero(reached):
        approach, lifted = ways(wide, T_world_tool, grasp, lift, SETTINGS.step)
        for branch in (b for b in range(8) if reached[grasp] >> b & 1):
            rows = np.vstack([follow(wide, approach, branch), follow(wide, lifted, branch)])
            expected[grasp] |= in_one_winding(limited, rows) << branch
    assert np.array_equal(left, expected)
    assert 0 < np.bitwise_count(left).sum() < np.bitwise_count(reached).sum()


def test_two_threads_may_ask_the_same_reach(reach):
    alone = [reach.branches(T, lift) for T, lift in PLACES.values()]
    with ThreadPoolExecutor(2) as pool:
        together = list(pool.map(lambda place: reach.branches(*place), list(PLACES.values()) * 2))
    assert all(np.array_equal(a, b) for a, b in zip(alone * 2, together, strict=True))


def test_an_object_put_elsewhere_on_the_tool_is_reached_as_if_it_had_ridden_there_at_first(
    cell, long_tool, long_grasps
) -> None:
    solid = solid_of(Box(type="box", size=(0.2, 0.1, 0.06)))
    body = Body("block", "object", Box(type="box", size=(0.2, 0.1, 0.06)), solid, 0.3, np.zeros(3), np.eye(4), False)
    workcell = ToolWorkcell(cell, long_tool, (body,))
    T_world_tool = standing(0.3, 0.1, 0.12, yaw=0.3)
    places = [transform(rotation_z(yaw), [0.02, 0.01, -0.0301]) for yaw in (0.0, 0.8, 2.1)]
    elsewhere = reach_of(workcell, "left", long_grasps, {"block": Riding("tool", places[0])})
    for T in places:
        there = reach_of(workcell, "left", long_grasps, {"block": Riding("tool", T)})
        expected = there.reached(T_world_tool, UP)
        found = elsewhere.reached(T_world_tool, UP, None, {"block": T})
        np.testing.assert_array_equal(found.branches, expected.branches)
        np.testing.assert_array_equal(found.faults, expected.faults)
        np.testing.assert_array_equal(found.faults == 0, found.branches > 0)
