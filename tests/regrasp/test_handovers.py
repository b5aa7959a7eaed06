"""Handover databases, with pinocchio's kinematics and python-fcl's distances as the authorities."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from planners.cell.cell import Cell, load_cell
from planners.errors import LiftwrightError, PlanningCancelled
from planners.geometry.pose import inverse, transform
from planners.kinematics.inverse import follow_branch
from planners.planning import MOST_HANDOVERS, HandoverMemory
from planners.progress import Progress, Report, silent
from planners.regrasp.grasps.handover_place import HandoverPlaceSettings, handover_place, tool_poses_at
from planners.regrasp.grasps.handovers import (
    HandoverDatabase,
    HandoverDataError,
    HandoverSettings,
    build_handovers,
    find_handovers,
    handover_key,
)
from planners.regrasp.grasps.tool_grasps import ToolGraspSettings
from planners.regrasp.tool_workcell import ToolWorkcell
from planners.scene.suction_tool import SuctionTool, load_tool
from tests.kinematics.arm_oracle import PinocchioArm
from tests.regrasp.hand_oracle import NEAR, ToolCell

SMALL = HandoverSettings(
    ToolGraspSettings(rolls=4), HandoverPlaceSettings(step=0.2, finest=0.2, grasps=16, best=2), axis_rolls=1
)
ARRAYS = ("place", "T_world_tool", "left", "right", "codes")


@pytest.fixture(scope="module")
def small(cell, short_tool) -> HandoverDatabase:
    return find_handovers(cell, short_tool, SMALL)


def way_back(cell, gripper, database, arm: str, o: int, grasp: int, branch: int, step: float) -> np.ndarray:
    """Joint positions (k, 6) of an arm back from a grasp, the grasp first."""
    T_flange_tcp = gripper.T_flange_tcp(float(database.grasps.widths[grasp]))
    T_world_flange = database.T_world_tool[o] @ database.grasps.T_tool_tcp[grasp] @ inverse(T_flange_tcp)
    flanges = [T_world_flange @ transform(None, [0, 0, -s]) for s in np.arange(0.0, 0.0701, step)]
    base = cell.arms[arm]
    return follow_branch(base.dh, inverse(base.T_world_base), np.array(flanges), branch, np.empty((0, 6)))


def arms_slack(cell, gripper, tool, database, o: int, pair, branches, pairs, step: float, margin: float) -> float:
    """The least slack while either arm comes and goes with open fingers, and while both hold; stops when negative."""
    probe, grasps = ToolCell(ToolWorkcell(cell, tool)), database.grasps
    left, right = (
        way_back(cell, gripper, database, arm, o, g, b, step)
        for arm, g, b in zip(("left", "right"), pair, branches, strict=True)
    )
    held = {arm: float(grasps.widths[g]) for arm, g in zip(("left", "right"), pair, strict=True)}
    opened = {arm: float(grasps.open_widths[g]) for arm, g in zip(("left", "right"), pair, strict=True)}
    moments = [(left[0], right[0], held, ("left", "right"))]
    moments += [(q, right[0], {**held, "left": opened["left"]}, ("right",)) for q in left]
    moments += [(left[0], q, {**held, "right": opened["right"]}, ("left",)) for q in right]
    slack = 1.0
    for q_left, q_right, widths, holding in moments:
        q = np.concatenate([q_left, q_right])
        slack = min(
            slack, probe.least_slack(q, database.T_world_tool[o], widths, pairs, holding=holding, margin=margin)
        )
        if slack <= 0.0:
            break
    return slack


def not_the_tool_at_rest(a, b) -> bool:
    """All pairs of the arms, among themselves and with all else."""
    return "left" in (a.group, b.group) or "right" in (a.group, b.group)


def between_arms(a, b) -> bool:
    return {a.group, b.group} == {"left", "right"}


@pytest.mark.slow
def test_in_a_stored_pair_nothing_touches_anything_at_any_moment(cell, gripper, short_tool, short_handovers):
    """Every body against every other, also between the places that were checked."""
    rng = np.random.default_rng(9)
    stored = np.argwhere(short_handovers.compatible)
    for o, one, two in rng.permutation(stored)[:5]:
        branches = short_handovers.branches(o, one, two)
        slack = arms_slack(
            cell, gripper, short_tool, short_handovers, o, (one, two), branches, not_the_tool_at_rest, 0.007, 0.0
        )
        assert slack > 0.0


def test_a_pair_that_is_not_stored_has_arms_that_meet_whatever_branches_reach_its_grasps(
    cell, gripper, short_tool, short_handovers
):
    rng, database = np.random.default_rng(10), short_handovers
    reached = (database.left > 0)[:, :, None] & (database.right > 0)[:, None, :]
    missing = np.argwhere(reached & ~database.compatible)
    assert len(missing)
    for o, one, two in rng.permutation(missing)[:6]:
        for branches in np.ndindex(8, 8):
            if database.left[o, one] >> branches[0] & 1 and database.right[o, two] >> branches[1] & 1:
                slack = arms_slack(
                    cell, gripper, short_tool, database, o, (one, two), branches, between_arms, 0.005, 0.003
                )
                assert slack < NEAR


def test_the_branches_of_a_pair_are_among_those_that_reach_its_grasps(short_handovers):
    database = short_handovers
    o, one, two = np.nonzero(database.codes)
    left, right = np.divmod(database.codes[o, one, two].astype(int) - 1, 8)
    assert (database.left[o, one] >> left & 1).all()
    assert (database.right[o, two] >> right & 1).all()
    assert database.branches(o[0], one[0], two[0]) == (left[0], right[0])


def test_every_orientation_of_the_tool_has_the_middle_of_its_grasps_at_the_place(short_handovers):
    database = short_handovers
    middle = np.append(database.grasps.T_tool_tcp[:, :3, 3].mean(axis=0), 1.0)
    assert database.T_world_tool @ middle == pytest.approx(np.tile(np.append(database.place, 1.0), (24, 1)))
    R = database.T_world_tool[:, :3, :3]
    turned = np.einsum("aij,bij->ab", R, R)
    assert turned.diagonal() == pytest.approx(3.0)
    assert (turned - 3.0 * np.eye(24)).max() < 2.0, "two orientations are the same"


def test_both_ways_to_ask_for_partners_agree(short_handovers):
    database = short_handovers
    grasp = int(database.partners.any(axis=1).argmax())
    partners = database.pairs_of("left", grasp)
    assert len(partners)
    for partner in partners[:5]:
        assert grasp in database.pairs_of("right", partner)
        there = database.orientations("left", grasp, "right", partner)
        assert len(there)
        assert np.array_equal(there, database.orientations("right", partner, "left", grasp))
    assert len(database.orientations("left", grasp, "left", grasp)) == 0


def slow_manipulability(cell, grasps, place: np.ndarray, chosen, best: int, axis_rolls: int) -> float:
    """The worse arm's mean over orientations and best grasps of |det J|, with pinocchio's Jacobian."""
    means = []
    for arm in cell.arms.values():
        oracle, values = PinocchioArm(arm.dh), []
        T_tool_flange = grasps.T_tool_flange(arm.hand)[chosen]
        for T_world_tool in tool_poses_at(place, grasps, axis_rolls):
            flanges = T_world_tool @ T_tool_flange
            rows = [
                follow_branch(arm.dh, inverse(arm.T_world_base), flanges[:, None][k], branch, np.empty((0, 6)))[0]
                for k in range(len(chosen))
                for branch in range(8)
            ]
            dets = [abs(np.linalg.det(oracle.jacobian(q))) if _within(arm, q) else 0.0 for q in rows]
            values.append(np.sort(np.reshape(dets, (-1, 8)).max(axis=1))[-best:].mean())
        means.append(np.mean(values))
    return min(means)


def _within(arm, q: np.ndarray) -> bool:
    turned = q + 2.0 * np.pi * np.array([[-1], [0], [1]])
    return bool(((turned >= arm.position_min) & (turned <= arm.position_max)).any(axis=0).all())


def test_no_place_of_the_grid_beats_the_handover_place(cell, short_grasps):
    settings = HandoverPlaceSettings(step=0.2, finest=0.2, grasps=6, best=2, axis_rolls=1)
    place = handover_place(cell, short_grasps, settings)
    chosen = np.unique(np.linspace(0, len(short_grasps) - 1, 6).round().astype(int))
    most = slow_manipulability(cell, short_grasps, place, chosen, 2, 1)
    assert most > 0.0
    base = np.array([0.0, 0.0, cell.table_top])
    corners = np.meshgrid((0.3, 0.4, 0.5, 0.6), (-0.1, 0.0, 0.1), (0.25, 0.35, 0.45, 0.55))
    grid = base + np.stack(corners, axis=-1).reshape(-1, 3)
    assert any(np.allclose(place, other) for other in grid)
    for other in np.random.default_rng(12).permutation(grid)[:8]:
        assert slow_manipulability(cell, short_grasps, other, chosen, 2, 1) <= most + 1e-9


def test_the_handover_place_of_the_long_tool_is_near_the_published_one(cell, long_grasps):
    """Measured with ten best of all grasps: 0.40 in front, in the middle, 0.45 over the table, within 0.05 flat."""
    place = handover_place(cell, long_grasps, HandoverPlaceSettings()) - [0.0, 0.0, cell.table_top]
    assert place == pytest.approx([0.40, 0.0, 0.45], abs=0.0501)


def test_a_database_that_is_written_and_read_is_the_same(short_handovers):
    data = short_handovers.to_bytes()
    again = HandoverDatabase.from_bytes(data, short_handovers.key)
    for name in ARRAYS:
        assert np.array_equal(getattr(again, name), getattr(short_handovers, name)), name
    grasps, read = short_handovers.grasps, again.grasps
    for name in ("T_tool_tcp", "widths", "open_widths"):
        assert np.array_equal(getattr(read, name), getattr(grasps, name)), name
    assert [f.rejection for f in read.fallen] == [f.rejection for f in grasps.fallen]
    assert all(np.array_equal(a.T_tool_tcp, b.T_tool_tcp) for a, b in zip(read.fallen, grasps.fallen, strict=True))
    assert again.to_bytes() == data


def test_the_same_question_has_the_same_database(cell, short_tool, small):
    assert find_handovers(cell, short_tool, SMALL).to_bytes() == small.to_bytes()


@pytest.mark.parametrize(
    "damage",
    [
        lambda data: data[:-1],
        lambda data: data[: len(data) // 2],
        lambda data: b"",
        lambda data: bytes([*data[:500], data[500] ^ 1, *data[501:]]),
        lambda data: b"\0" * len(data),
    ],
    ids=["an end short", "half", "empty", "a bit turned", "zeros"],
)
def test_damaged_data_is_refused(small, damage):
    with pytest.raises(HandoverDataError):
        HandoverDatabase.from_bytes(damage(small.to_bytes()), small.key)


def test_data_of_another_key_is_refused(small):
    with pytest.raises(HandoverDataError, match="another"):
        HandoverDatabase.from_bytes(small.to_bytes(), "0" * 64)


def test_the_key_tells_cells_tools_and_settings_apart_and_nothing_else(cell, short_tool, long_tool):
    settings = HandoverSettings()
    moved = load_tool("short_asymmetric").at(transform(None, [0.3, 0.1, 1.2]))
    key = handover_key(cell, short_tool, settings)
    assert handover_key(load_cell("dual_ur3e_tool"), moved, HandoverSettings()) == key
    others = [
        handover_key(cell, long_tool, settings),
        handover_key(replace(cell, hash="other"), short_tool, settings),
        handover_key(cell, short_tool, replace(settings, axis_rolls=2)),
        handover_key(cell, short_tool, replace(settings, grasps=replace(settings.grasps, margin=0.002))),
    ]
    assert len({key, *others}) == 5


def test_progress_goes_through_all_orientations_and_can_stop_the_work(cell, short_tool):
    seen = []
    grasps = find_handovers(cell, short_tool, SMALL, lambda report: seen.append(report[:3])).grasps
    assert seen == [("handovers", o, 6) for o in range(7)]

    def stop(report: Report, /) -> None:
        raise PlanningCancelled(f"{report.stage} {report.done} {report.total}")

    with pytest.raises(PlanningCancelled, match="handovers 0 6"):
        build_handovers(cell, short_tool, grasps, SMALL, stop)


def test_two_hands_that_are_not_equal_grippers_are_refused(short_tool, short_grasps):
    with pytest.raises(LiftwrightError, match="equal grippers"):
        build_handovers(load_cell("dual_ur3e_lift"), short_tool, short_grasps, SMALL)


def test_a_tool_without_grasps_has_an_empty_database(cell, short_tool, short_grasps):
    none = replace(short_grasps, T_tool_tcp=np.empty((0, 4, 4)), widths=np.empty(0), open_widths=np.empty(0))
    database = build_handovers(cell, short_tool, none, SMALL)
    assert database.partners.shape == (0, 0)
    assert not database.compatible.any()
    assert HandoverDatabase.from_bytes(database.to_bytes(), database.key).codes.shape == database.codes.shape


def test_the_long_tool_offers_more_pairs_than_the_short_one(long_handovers, short_handovers):
    """Table II's point; measured: 101,380 pairs by orientation against 9,816, 42,404 distinct against 4,268."""
    assert 0.5 * 101_380 < long_handovers.compatible.sum() < 1.5 * 101_380
    assert 0.5 * 42_404 < long_handovers.partners.sum() < 1.5 * 42_404
    assert long_handovers.partners.sum() > 3 * short_handovers.partners.sum()


def test_the_last_handovers_are_remembered_and_those_before_are_found_again(cell, short_tool, small) -> None:
    asked: list[HandoverSettings] = []

    def source(_: Cell, __: SuctionTool, settings: HandoverSettings, ___: Progress) -> HandoverDatabase:
        asked.append(settings)
        return replace(small, key=f"{len(asked)}")

    settings = [replace(SMALL, axis_rolls=rolls) for rolls in range(1, MOST_HANDOVERS + 2)]
    memory = HandoverMemory(source)
    for each in (*settings[:-1], settings[0], settings[-1]):
        found = memory(cell, short_tool, each, silent)
        assert memory(cell, short_tool, each, silent) is found
    assert asked == settings
    # The first was asked for once more, so that it is the second that has left.
    memory(cell, short_tool, settings[0], silent)
    memory(cell, short_tool, settings[1], silent)
    assert asked == [*settings, settings[1]]
