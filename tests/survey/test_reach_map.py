"""Maps of reach: what they claim stands a look by other means, and mirror images have mirrored maps."""

from __future__ import annotations

import itertools
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from planners.cell.bundle import CellBundle
from planners.cell.cell import Cell, load_cell
from planners.cell.hand import Gripper
from planners.geometry.pose import inverse
from planners.hands.workcell import Clearance
from planners.kinematics.inverse import inverse_kinematics, within_limits
from planners.kinematics.joint_torque import joint_torques
from planners.survey.reach_map import (
    DIRECTIONS,
    HandLooker,
    ReachMap,
    ReachMapSettings,
    _bearable,
    map_reach,
    turns_about,
)
from planners.survey.survey import CellSurvey
from tests.cell.cell_probe import cell_frames, fcl_distance, fcl_object
from tests.support.own_cell import station, written
from tests.support.samples import sample

COARSE = ReachMapSettings(columns=14, rolls=4)
MIRRORED = {"left": "right", "right": "left", "down and left": "down and right", "down and right": "down and left"}


@pytest.fixture(scope="module")
def cell() -> Cell:
    return load_cell("dual_ur3e_tool")


@pytest.fixture(scope="module")
def reach(cell: Cell) -> ReachMap:
    return map_reach(cell, COARSE)


@pytest.mark.slow
def test_what_is_reached_is_what_any_branch_and_turn_reaches_clear_of_everything(cell: Cell, reach: ReachMap) -> None:
    """Every pair that may meet is asked of python-fcl; what is within a hair of the margin decides nothing."""
    chance, names = np.random.default_rng(1), list(DIRECTIONS)
    bodies, margin = cell.collision_bodies(), Clearance().margin
    pairs = [pair for pair in itertools.combinations(bodies, 2)
             if pair[0].frame != pair[1].frame
             and tuple(sorted((pair[0].name, pair[1].name))) not in cell.excluded_pairs]  # fmt: skip
    seen = set()
    for _ in range(sample(12, 120)):
        i, j, d = (int(chance.integers(count)) for count in reach.reached["left"].shape)
        found, close = False, False
        for turn in turns_about([DIRECTIONS[names[d]]], COARSE.rolls)[0]:
            for Q in _postures(cell, [reach.x[i], reach.y[j], reach.z], turn):
                frames = cell_frames(cell, Q)
                gaps = [fcl_distance(*(fcl_object(body, frames[body.frame]) for body in pair)) for pair in pairs]
                close |= abs(min(gaps) - margin) < 3e-4
                found |= min(gaps) > margin
        if not close:
            assert reach.reached["left"][i, j, d] == found
            seen.add(found)
    assert seen == {True, False}


def _postures(cell: Cell, place: list[float], turn: np.ndarray) -> list[np.ndarray]:
    arm, solutions = cell.arms["left"], np.empty((8, 6))
    hand = arm.hand
    assert isinstance(hand, Gripper)
    T_world_tcp = turn.copy()
    T_world_tcp[:3, 3] = place
    T_base_flange = inverse(arm.T_world_base) @ T_world_tcp @ inverse(hand.T_flange_tcp(hand.width_max))
    valid = inverse_kinematics(arm.dh, np.ascontiguousarray(T_base_flange), 0.0, solutions)
    kept = [q for k, q in enumerate(solutions) if (valid >> k) & 1]
    within = [q for q in kept if within_limits(q, arm.position_min, arm.position_max)]
    return [np.concatenate([q, cell.arms["right"].home]) for q in within]


def test_a_cell_that_is_its_own_mirror_image_has_a_map_that_is(cell: Cell, reach: ReachMap) -> None:
    ways = [list(DIRECTIONS).index(MIRRORED.get(way, way)) for way in DIRECTIONS]
    np.testing.assert_array_equal(reach.reached["left"][:, ::-1][:, :, ways], reach.reached["right"])
    np.testing.assert_array_equal(reach.anyhow["left"][:, ::-1], reach.anyhow["right"])


def test_a_hand_may_hold_the_most_that_it_may_in_any_of_its_turns() -> None:
    """Where everything weighs so much that torques end it before the payload does, at some places."""
    cell = replace(load_cell("dual_ur10e_lift"), gravity=np.array([0.0, 0.0, -14.0]))
    arm, (table, *_) = cell.arms["left"], cell.boxes
    steps = itertools.product(np.linspace(-0.45, 0.45, 11), repeat=2)
    places = np.array([[*(table.center[:2] + np.array(step) * table.size[:2]), cell.table_top + 0.1] for step in steps])
    places = places[np.linalg.norm(places - arm.T_world_base[:3, 3], axis=1) < arm.robot.reach]
    turns = turns_about(DIRECTIONS.values(), 4)
    reached, most = HandLooker(cell, turns).look("left", places)
    each = (turns[d : d + 1, k : k + 1] for d, k in np.ndindex(turns.shape[:2]))
    one_by_one = [HandLooker(cell, turn).look("left", places) for turn in each]
    np.testing.assert_array_equal(reached.any(axis=1), np.any([found[:, 0] for found, _ in one_by_one], axis=0))
    np.testing.assert_array_equal(most, np.max([held for _, held in one_by_one], axis=0))
    assert np.any((most > 0.0) & (most < arm.spare_payload))


def test_what_a_hand_may_hold_ends_at_the_payload_or_where_a_joint_can_no_more(cell: Cell) -> None:
    arm, chance = cell.arms["left"], np.random.default_rng(2)
    weighed = arm.weighed(cell.gravity)
    ended = set()
    for _ in range(40):
        q, point = chance.uniform(-3, 3, 6), chance.uniform(-0.3, 0.3, 3) + arm.T_world_base[:3, 3]
        limits = arm.torque_max * chance.uniform(0.4, 1.0)
        mass = _bearable((weighed, limits, arm.spare_payload), q, point)
        load = np.concatenate([-mass * cell.gravity, np.zeros(3)])
        still = np.zeros((1, 6))
        share = np.abs(joint_torques(weighed, q[None], still, still, load[None], point[None])[0]) / limits
        at_limit = mass == pytest.approx(arm.spare_payload)
        ended.add(bool(at_limit))
        if mass > 0.0:
            assert share.max() <= 1.0 + 1e-9
        if not at_limit and mass > 0.0:
            assert share.max() == pytest.approx(1.0)
    assert ended == {True, False}


def test_a_survey_counts_what_the_map_shows(cell: Cell, reach: ReachMap) -> None:
    survey = CellSurvey.of(cell, COARSE)
    figures = survey.figures()
    places = reach.common.size
    assert figures.common == pytest.approx((reach.anyhow["left"] & reach.anyhow["right"]).sum() / places, abs=1e-4)
    assert figures.dead == pytest.approx((~(reach.anyhow["left"] | reach.anyhow["right"])).sum() / places, abs=1e-4)
    assert figures.plate is None
    assert figures.handover is not None
    low, high = np.array(figures.handover.low), np.array(figures.handover.high)
    assert (high >= low).all()
    # The hands meet between the arms, which are mirror images.
    np.testing.assert_allclose(low[1], -high[1], atol=1e-9)
    assert any("meet" in sentence for sentence in figures.sentences)


def test_the_largest_plate_has_a_hand_at_each_of_two_sides_and_lies_above_the_table(tmp_path: Path) -> None:
    survey = CellSurvey.of(CellBundle.of_text(written(station())).load(tmp_path), COARSE)
    plate, reach = survey.figures().plate, survey.reach
    assert plate is not None
    table = survey.cell.boxes[0]
    for axis in range(2):
        assert abs(plate.position[axis] - table.center[axis]) + 0.5 * plate.side <= 0.5 * table.size[axis] + 0.05
    rims = {"back": (0.5, 0), "forward": (-0.5, 0), "right": (0, 0.5), "left": (0, -0.5)}

    def comes(arm: str, way: str) -> bool:
        x, y = (plate.position[axis] + plate.side * rims[way][axis] for axis in range(2))
        i, j = int(np.abs(reach.x - x).argmin()), int(np.abs(reach.y - y).argmin())
        near = reach.from_way(arm, way)[max(0, i - 1) : i + 2, max(0, j - 1) : j + 2]
        return bool(near.any())

    assert any(comes("right", one) and comes("left", other) for one, other in itertools.permutations(rims, 2))
