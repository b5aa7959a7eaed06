"""Hands that follow a lifter by what wrists feel, through the programs of the export, in physics."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest

from planners.contract.arrays import ArmName
from planners.contract.task_spec import PlateLiftTask
from planners.kinematics.forward import flange_pose_of_plan
from planners.plan.plan import Plan
from planners.program.schedule import Schedule, WrenchCurve
from tests.support.controller.executed import STANDSTILL, executed
from tests.support.controller.physical_cell import PhysicalLift, physical_cell
from tests.support.controller.stand_in import Recording
from tests.support.documents import plan_of
from tests.support.plan_shelf import PlanShelf
from tests.support.service import task
from workers.simulation.settings import CupSettings

NORMAL = 1
"""RTDE's `safety_mode` of an arm that was not stopped."""


@contextmanager
def lift_of(whole: Schedule, seed: int, lets_go: float = math.inf) -> Iterator[tuple[Schedule, PhysicalLift]]:
    """Give a world in which all but the lift is done, and the last moment of the plan with the lift after it."""
    with physical_cell(whole, seed, lets_go) as physics:
        assert isinstance(physics, PhysicalLift)
        joints, last, moment = physics.prepare(), whole.steps[-1], 0.1
        ended = {
            arm: replace(
                each, time=each.time[:1], positions=joints[arm][None], velocities=each.velocities[-1:],
                wrenches=WrenchCurve(np.array([0.0, moment]), each.wrenches.values[[-1, -1]]),
            )
            for arm, each in last.arms.items()
            if each.wrenches is not None
        }  # fmt: skip
        step = replace(last, begin=last.begin + last.duration, duration=moment, arms=ended)
        physics.schedule = replace(whole, steps=(step,))
        yield physics.schedule, physics


def heights(schedule: Schedule, arm: ArmName, recording: Recording, since: float) -> np.ndarray:
    """Return how high a flange is in each control cycle since a time [m]."""
    described = schedule.plan.cell.arms[arm]
    joints = recording.q[recording.time > since]
    return np.array([flange_pose_of_plan(described.dh, described.T_world_base, q)[2, 3] for q in joints])


@pytest.fixture(scope="module")
def ab1(shelf: PlanShelf) -> Schedule:
    return Schedule.of(plan_of(shelf.document(task("ab1.json"))))


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(20))
def test_hands_follow_whoever_raises_the_lifter_unevenly(ab1: Schedule, seed: int) -> None:
    """By what wrists feel alone: the cup bears no more than it can for long, and neither hand slips."""
    seconds, settings = 2.0, CupSettings()
    with lift_of(ab1, seed) as (schedule, physics):
        execution, recordings = executed(schedule, physics, seconds)
        assert physics.gave_way is None
        assert execution.is_done, execution.stop
        samples = physics.samples
    for arm, recording in recordings.items():
        assert np.diff(heights(ab1, arm, recording, physics.begun)).min() > -1e-6, "a hand went down"
    assert samples[-1].time > seconds, "the lift ended too soon"
    assert max(abs(each.risen - each.followed) for each in samples) < settings.travel
    assert max(each.pull for each in samples) < settings.burst * plate_task(ab1.plan).cup.max_force
    risen = np.array([each.risen for each in samples])
    assert samples[-1].followed == pytest.approx(risen[-1], abs=settings.travel)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_a_cup_that_lets_go_leaves_both_hands_at_rest(ab1: Schedule, seed: int) -> None:
    """What the lifter bore comes on the hands at once: they rise no more, and never go down."""
    slip = 1.0
    with lift_of(ab1, seed, lets_go=slip) as (schedule, physics):
        _, recordings = executed(schedule, physics, slip + 0.5)
        begun = physics.begun
    for arm, recording in recordings.items():
        risen, times = heights(ab1, arm, recording, begun), recording.time[recording.time > begun] - begun
        assert np.ptp(risen[times < slip]) > 1e-3, "they stood still before"
        assert np.abs(np.diff(risen[times > slip + STANDSTILL])).max() < 1e-9
        assert np.diff(risen).min() > -1e-6
        assert (recording.safety_mode == NORMAL).all()


def plate_task(plan: Plan) -> PlateLiftTask:
    assert isinstance(plan.task, PlateLiftTask)
    return plan.task
