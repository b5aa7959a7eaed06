"""The planner's loop: hands within their arms' payloads, whatever is asked for; a failure that teaches nothing."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import replace
from functools import reduce
from operator import or_
from typing import Any

import numpy as np
import pytest

from planners.errors import PlanningFaultError
from planners.graph.rejections import Rejection
from planners.manipulation.graph.failures import Failures, PairFailure
from planners.manipulation.lift_plan import LiftPlan
from planners.manipulation.lift_search import LiftSearch
from planners.manipulation.motion.choreography import Choreographer, StuckStep
from planners.manipulation.planner import PlateLiftPlanner
from planners.plan.verdicts import PlanningOutcome
from tests.manipulation.lift_probe import planner_of, task_body
from tests.support.documents import cell_of


def planned(**limits: float) -> tuple[PlateLiftPlanner, LiftPlan]:
    planner = planner_of({**task_body("ab1"), "hand_force_limit": limits})
    return planner, planner.plan()


def payloads(planner: PlateLiftPlanner) -> dict[str, float]:
    """What each arm's payload leaves beside its hand [N], of what a document states."""
    cell = cell_of(planner.scene.cell)
    return {name: 9.81 * (arm["payload"] - cell["hands"][name]["mass"]) for name, arm in cell["arms"].items()}


@pytest.mark.slow
def test_hands_bear_no_more_than_their_arms_whatever_a_task_allows() -> None:
    """The fault of before: with 100 N allowed, 40 N on the gripping hand and 36 N on the pushing one."""
    planner, generous = planned(normal=100.0, net=100.0)
    most = payloads(planner)
    assert most[planner.sampling.workcell.gripper] == pytest.approx(17.6, abs=0.1)
    assert most[planner.sampling.workcell.pusher] == pytest.approx(25.5, abs=0.1)
    largest = max(most.values())
    _, true = planned(normal=largest, net=largest)
    assert generous.outcome is true.outcome is PlanningOutcome.SOLVED
    assert len(generous.segments) == len(true.segments)
    for ours, theirs in zip(generous.segments, true.segments, strict=True):
        assert ours.kind is theirs.kind
        assert np.array_equal(ours.trajectory.positions, theirs.trajectory.positions)
        for one, other in zip(ours.contact_sets, theirs.contact_sets, strict=True):
            assert one.sample == other.sample
            assert one.balance.objective == pytest.approx(other.balance.objective, abs=1e-4)
            forces = np.linalg.norm(one.balance.hand_wrenches[:, :3], axis=1)
            assert forces[0] <= most[planner.sampling.workcell.gripper]
            assert forces[1] <= most[planner.sampling.workcell.pusher]


@pytest.mark.slow
def test_a_task_may_allow_less() -> None:
    _, plan = planned(normal=16.0, net=16.0)
    assert plan.outcome is PlanningOutcome.SOLVED
    for segment in plan.segments:
        for each in segment.contact_sets:
            assert np.linalg.norm(each.balance.hand_wrenches[:, :3], axis=1).max() <= 16.0


def test_a_failure_that_forbids_nothing_is_told_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    planner, tries = planner_of(task_body("pb1", hold_density=0.5)), list[Any]()
    monkeypatch.setattr(LiftSearch, "_realise", lambda _, sequence: tries.append(sequence))
    with pytest.raises(PlanningFaultError, match="nothing was forbidden"):
        planner.plan()
    assert len(tries) == 1


@pytest.mark.slow
def test_a_hand_that_does_not_come_whatever_the_other_holds_is_not_tried_with_all_its_holds(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """After so many holds of the other hand, only postures that were never tried at the pose are."""
    stated, enough, tried = planner_of(task_body("pb1", hold_density=0.5)), 3, defaultdict[Any, list[int]](list)
    planner = PlateLiftPlanner(stated.scene, replace(stated.settings, stuck_pairs=enough), lambda *_: None)

    def second_hand_stays_away(_: Choreographer, sequence: Any, assignment: object) -> StuckStep:
        del assignment
        late = [phase for phase in sequence.phases if phase.first > 0]
        return StuckStep(Rejection("transit", "no way"), "arrival", late[-1].hand, late[-1].first)

    def watched(failures: Failures, failure: Any, graph: Any) -> int:
        if isinstance(failure, PairFailure) and failure.coming is not None:
            before = tried[failure.pose, failure.changing, failure.coming.index]
            assert len(before) < enough or failure.coming.postures & ~reduce(or_, before)
            before.append(failure.coming.postures)
        return added(failures, failure, graph)

    added = Failures.add
    monkeypatch.setattr(Choreographer, "realise", second_hand_stays_away)
    monkeypatch.setattr(Failures, "add", watched)
    planner.plan(explained=False)
    assert max(len(each) for each in tried.values()) >= enough
