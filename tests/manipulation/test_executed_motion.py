"""What a choreographer makes of trouble: bodies in the way of timed motion, paths that jump, searches that give up."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from planners.balance.balanced import Unbalanced, UnbalanceReason
from planners.collision.model import Attached
from planners.errors import SceneError
from planners.hands import arm_motion
from planners.manipulation.motion.choreography import PERSISTENCE, Choreographer, StuckStep, _at_rest, _Run
from planners.manipulation.motion.phase_track import PhaseTrack
from planners.motion.query import MotionOutcome, MotionResult
from planners.plan.segment import SegmentKind
from tests.cell.cell_probe import fcl_distance, fcl_object
from tests.manipulation.lift_probe import FclCell, planner_of, task_body

BLOCK = 0.03


def workcell_with_block(position):
    """Return the workcell of AB3 with one more obstacle."""
    block = {
        "name": "block",
        "shape": {"type": "box", "size": [BLOCK] * 3},
        "pose": [*map(float, position), 1, 0, 0, 0],
    }
    return planner_of({**task_body("ab3"), "obstacles": [block]}).sampling.workcell


def attempt(planner, assigner, workcell=None):
    """Choreograph the sequence that was found, with its first choice of postures."""
    choreographer = Choreographer(
        workcell or planner.sampling.workcell, planner.reach.follower, planner.balance, np.random.default_rng(0)
    )
    return choreographer.realise(assigner.sequence, next(assigner.assignments()))


def transfers(segments):
    return [segment for segment in segments if segment.kind is SegmentKind.TRANSFER and segment.movers]


def test_a_block_among_the_arms_of_a_timed_transfer_is_noticed_exactly_when_fcl_says_so(planner, solved, holding_cell):
    """The block stands beside a joint of an arm at a random sample; close calls are left out."""
    rng, verdicts = np.random.default_rng(5), []
    for _ in range(12):
        segment = transfers(solved.segments)[int(rng.integers(len(transfers(solved.segments))))]
        q = segment.trajectory.positions
        sample = int(rng.integers(len(q)))
        frames = holding_cell.frames(q[sample], segment.T_world_body[sample])
        arm = segment.movers[int(rng.integers(len(segment.movers)))]
        position = frames[f"{arm}/{rng.integers(2, 4)}"][:3, 3] + rng.normal(0.0, 0.08, 3)
        try:
            workcell = workcell_with_block(position)
        except SceneError:
            continue
        hands = [hold.arm for hold in (segment.grip, segment.push) if hold is not None]
        carrier = min(segment.movers)
        flange = frames[f"{carrier}/6"]
        plate = Attached(carrier, np.linalg.inv(flange) @ segment.T_world_body[sample])
        found = workcell.transfer_query(plate, hands).path(q)
        cell = FclCell(workcell, holding=segment.grip is not None)

        def with_block(a, b, arms=frozenset(segment.movers)) -> bool:
            names = {a.name, b.name}
            return "block" in names and (bool({a.group, b.group} & arms) or bool(names & {"plate", "cup"}))

        slack = min(
            cell.least_slack(q[k], segment.T_world_body[k], with_block, hands, 0.0) for k in range(0, len(q), 6)
        )
        if slack > 0.006:
            assert found.free
        elif slack < -1e-4:
            assert not found.free
            assert "block" in workcell.transfer_query(plate, hands).pair_names(found.pair)
        verdicts.append(found.free)
    assert 2 <= sum(verdicts) <= len(verdicts) - 2


def test_what_only_the_timed_motion_meets_is_named_and_stops_the_attempt(planner, solved, assigner, holding_cell):
    """The postures were chosen without the block: only the motion itself can find it."""
    last = transfers(solved.segments)[-1]
    middle = len(last.trajectory.time) // 2
    elbow = holding_cell.frames(last.trajectory.positions[middle], last.T_world_body[middle])["right/2"][:3, 3]
    result = attempt(planner, assigner, workcell_with_block(elbow))
    assert isinstance(result, StuckStep)
    assert "block" in result.rejection.reason


def test_a_path_that_jumps_or_ends_is_no_failure_of_the_planner(planner, assigner, monkeypatch):
    exact = PhaseTrack.exact

    def broken(self, T_world_carriers, reference):
        q = exact(self, T_world_carriers, reference)
        away = np.linalg.norm(T_world_carriers[:, :3, 3] - planner.scene.T_world_plate[:3, 3], axis=1)
        q[away > 0.02] += self.jump
        return q

    monkeypatch.setattr(PhaseTrack, "exact", broken)
    for jump in (np.nan, 0.5):
        monkeypatch.setattr(PhaseTrack, "jump", jump, raising=False)
        result = attempt(planner, assigner)
        assert isinstance(result, StuckStep)
        assert result.step == "arrival"
        assert "the path" in result.rejection.reason


def test_a_search_that_was_exhausted_is_made_once_more_with_more_patience(planner, assigner, monkeypatch):
    asked: list[int] = []

    def exhausted(query, settings, rng):
        asked.append(settings.max_iterations)
        return MotionResult(MotionOutcome.ITERATIONS_EXHAUSTED)

    monkeypatch.setattr(arm_motion, "plan_motion", exhausted)
    result = attempt(planner, assigner)
    assert isinstance(result, StuckStep)
    assert (result.step, result.place) == ("arrival", 0)
    assert asked == [asked[0], PERSISTENCE * asked[0]]


def test_a_rest_that_is_not_balanced_is_told_with_the_edge_it_is_on(planner, assigner, monkeypatch):
    sequence = assigner.sequence
    changes = [place for place, step in enumerate(sequence.motions) if step is None]
    assert changes
    known = _Run.balance_at

    def unbalanced_late(self, pose, hands):
        late = self.state.edge == changes[-1]
        return Unbalanced(UnbalanceReason.PROVEN, None, 0.0) if late else known(self, pose, hands)

    monkeypatch.setattr(_Run, "balance_at", unbalanced_late)
    result = attempt(planner, assigner)
    assert isinstance(result, StuckStep)
    assert (result.step, result.hand, result.place) == ("rest", None, changes[-1])


@pytest.mark.parametrize("seed", range(20))
def test_contact_sets_at_rest_are_few_and_no_farther_apart_than_a_pause(seed):
    rng = np.random.default_rng(seed)
    time = np.concatenate([[0.0], np.cumsum(rng.uniform(0.001, 0.02, int(rng.integers(1, 200))))])
    samples = list(_at_rest(time, 0.24))
    assert samples[0] == 0
    assert samples[-1] == len(time) - 1
    assert all(time[b] - time[a] <= 0.24 for a, b in pairwise(samples))
    assert all(time[samples[i + 2]] - time[samples[i]] > 0.24 for i in range(len(samples) - 2))


def test_the_plan_starts_at_the_opening_that_the_scene_was_checked_with(planner, solved):
    gripper = planner.sampling.workcell.gripper
    assert solved.segments[0].widths[gripper][0] == planner.scene.start_widths[gripper]


def test_bodies_may_be_as_close_as_the_task_puts_them_but_no_closer(planner):
    """Oracle: fcl's distances at the start. The block is 2 mm beside the plate, on the side of its x axis."""
    plate = planner.scene.plate
    beside = plate.T_world_body[:3, :3] @ [0.5 * np.ptp(plate.outline[:, 0]) + 0.002 + 0.5 * BLOCK, 0.0, 0.0]
    yaw = np.arctan2(plate.T_world_body[1, 0], plate.T_world_body[0, 0])
    position = (plate.T_world_body[:3, 3] + beside).tolist()
    pose = [*position, np.cos(yaw / 2), 0.0, 0.0, np.sin(yaw / 2)]
    block = {"name": "block", "shape": {"type": "box", "size": [BLOCK] * 3}, "pose": pose}
    workcell = planner_of({**task_body("ab3"), "obstacles": [block]}).sampling.workcell
    cell, start = FclCell(workcell, holding=False), workcell.scene.start_positions
    T_world_plate = workcell.scene.T_world_plate
    near = {frozenset(pair): margin for pair, margin in workcell.start_margins.items()}
    frames = cell.frames(start, T_world_plate)
    objects = {body.name: fcl_object(body, frames[body.frame]) for body in cell.bodies.values()}
    for a, b in cell.pairs(lambda a, b: True):
        gap = fcl_distance(objects[a.name], objects[b.name])
        margin = near.get(frozenset((a.name, b.name)))
        assert (margin is not None) == (gap < workcell.settings.margin)
        assert margin is None or margin == pytest.approx(max(0.0, gap), abs=2e-6)
    assert near[frozenset(("block", "plate"))] == pytest.approx(0.002, abs=2e-6)
    lifted = workcell.plate_query(workcell.holding, workcell.lifted, hands=[])
    closer = T_world_plate.copy()
    closer[:3, 3] += 1e-5 * beside / np.linalg.norm(beside)
    free, touching = lifted.first_collisions(np.array([T_world_plate, closer]))
    assert free < 0
    assert touching >= 0
