"""Shipped plans executed on two stand-in controllers in physics, to their end."""

from __future__ import annotations

import math

import numpy as np
import pytest

from planners.geometry.pose import rotation_angle
from planners.kinematics.forward import flange_pose, flange_pose_of_plan
from planners.lifting.hand_admittance import HandAdmittance
from planners.program.schedule import Schedule
from planners.program.urscript import BEARING_TOLERANCE
from tests.support.controller.executed import Recordings, apart, assert_as_planned, curve, executed, off_plan, running
from tests.support.controller.physical_cell import PhysicalLift, PhysicalPile, physical_cell
from tests.support.documents import plan_of
from tests.support.plan_shelf import PlanShelf
from tests.support.service import ROOT, task

SHIPPED = sorted(path.name for path in (ROOT / "assets/tasks").glob("*.json"))


def assert_on_plate_as_planned(schedule: Schedule, recordings: Recordings) -> None:
    """Hands on the plate are off the plan by no more than they may give way, and lose that once they have let go."""
    for arm, recording in recordings.items():
        described, free = schedule.plan.cell.arms[arm], math.inf
        for step in schedule.steps:
            mine = step.arms[arm]
            assert mine.wrenches is not None
            rows = np.flatnonzero(running(recording, step.number))[::20]
            assert len(rows)
            if mine.wrenches.bears:
                free = 0.0
            planned = curve(schedule, arm, step.number)(np.clip(recording.path_time[rows], 0.0, step.duration))
            if not mine.wrenches.bears:
                left = BEARING_TOLERANCE * math.exp(-free / HandAdmittance.fading)
                assert off_plan(schedule, arm, step, recording) < left + 1e-3
                free += step.duration
            for q, planned_q in zip(recording.q[rows], planned, strict=True):
                T, T_planned = (
                    flange_pose_of_plan(described.dh, described.T_world_base, each) @ mine.T_flange_tcp
                    for each in (q, planned_q)
                )
                assert np.linalg.norm(T[:3, 3] - T_planned[:3, 3]) < HandAdmittance.largest_correction + 1e-3
                assert rotation_angle(T[:3, :3], T_planned[:3, :3]) < HandAdmittance.largest_turning + 1e-2


@pytest.mark.slow
@pytest.mark.parametrize("name", SHIPPED)
def test_shipped_tasks_that_have_a_plan_are_executed_to_their_end(shelf: PlanShelf, name: str) -> None:
    """In physics: hands hold the plate, the cup its objects, by nothing but what the programs have the arms do."""
    document = shelf.document(task(name))
    if document["outcome"] != "solved":
        assert "segments" not in document or not document["segments"]
        return
    schedule = Schedule.of(plan_of(document))
    compiled = set(flange_pose.signatures)
    with physical_cell(schedule) as physics:
        execution, recordings = executed(schedule, physics, 1.0)
        assert physics.gave_way is None
        assert execution.is_done, execution.stop
        for step in schedule.steps:
            assert np.percentile(apart(recordings, step.number), 99) < 0.008
        # Nothing was compiled for a plan's arrays, which are not to be written to, while arms moved.
        assert all(argument.mutable for signature in set(flange_pose.signatures) - compiled for argument in signature)
        if isinstance(physics, PhysicalLift):
            assert_on_plate_as_planned(schedule, recordings)
            assert physics.untracked
            admittance = schedule.admittance
            # What the leak leaves of the largest correction, and what a sensor's noise does.
            most = admittance.leak * admittance.damping * admittance.largest_correction + 1.0
            assert all(np.median(off) < most for off in physics.untracked.values())
            assert physics.samples[-1].followed > 0.0
        else:
            assert_as_planned(schedule, recordings)
            assert_at_goals(physics)


def assert_at_goals(physics: PhysicalPile) -> None:
    watch = physics.execution.settings.watch
    for error in physics.execution.goal_errors().values():
        assert error.distance < watch.goal_distance
        assert error.angle < watch.goal_angle
