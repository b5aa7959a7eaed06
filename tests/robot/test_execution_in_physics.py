"""Shipped plans executed on two stand-in controllers in physics, to their end and stopped midway."""

from __future__ import annotations

import io
import math

import numpy as np
import pytest
from support.controller.executed import (
    STANDSTILL,
    Cell,
    Recordings,
    apart,
    assert_as_planned,
    curve,
    executed,
    off_plan,
    running,
)
from support.controller.lock_step import lock_step
from support.controller.physical_cell import PhysicalLift, PhysicalPile, physical_cell
from support.controller.stand_in import hosts
from support.documents import plan_of
from support.plan_shelf import PlanShelf
from support.service import ROOT, task

from planners.geometry.pose import rotation_angle
from planners.kinematics.forward import flange_pose
from planners.lifting.hand_admittance import HandAdmittance
from planners.plan.scenery import ARMS
from planners.plan.segment import SegmentKind
from planners.program.schedule import ProgramStep, Schedule
from planners.program.urscript import BEARING_TOLERANCE
from workers.robot.execution_log import ExecutionLog
from workers.robot.executor import ExecutionSettings, Executor
from workers.robot.supervision import StopReason

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
                    flange_pose(described.dh, described.T_world_base, each) @ mine.T_flange_tcp
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
    with physical_cell(schedule) as physics:
        execution, recordings = executed(schedule, physics, 1.0)
        assert physics.gave_way is None
        assert execution.is_done, execution.stop
        for step in schedule.steps:
            assert np.percentile(apart(recordings, step.number), 99) < 0.008
        if isinstance(physics, PhysicalLift):
            assert_on_plate_as_planned(schedule, recordings)
            assert physics.untracked
            admittance = HandAdmittance()
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


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "part", "speed", "drops"),
    [
        *(("ab1.json", 0.5, 1.0, False), ("pb2.json", 0.8, 1.0, False)),
        *(("can_stack.json", 0.3, 1.0, False), ("domino_pile.json", 0.7, 1.0, False)),
        # Far from the hand that bears it, and what the world has to say of a stop from more than a stop is borne from.
        *(("carton_pile.json", 0.3, 1.0, False), ("carton_pile.json", 0.3, 0.6, True)),
        ("carton_pile.json", 0.1, 0.25, False),
    ],
)  # fmt: skip
def test_a_stop_on_request_drops_nothing(shelf: PlanShelf, name: str, part: float, speed: float, drops: bool) -> None:
    settings = ExecutionSettings(speed, stops_may_drop=drops)
    gave_way = stopped_midway(shelf, name, part, settings, protective=False)
    assert (gave_way is not None) == drops


@pytest.mark.slow
@pytest.mark.parametrize(("name", "part"), [("ab1.json", 0.2), ("domino_pile.json", 0.2)])
def test_a_slow_arm_that_is_stopped_for_protection_drops_nothing(shelf: PlanShelf, name: str, part: float) -> None:
    """That arm brakes as hard as it can, the other one as programs do, with what they hold."""
    assert stopped_midway(shelf, name, part, ExecutionSettings(0.25), protective=True) is None


def stopped_midway(
    shelf: PlanShelf, name: str, part: float, settings: ExecutionSettings, *, protective: bool
) -> str | None:
    """Stop both arms in the middle of a step in which something is carried; returns what gave way."""
    schedule = Schedule.of(plan_of(shelf.document(task(name))))
    carrying = [step for step in schedule.steps if step.kind is SegmentKind.TRANSFER and step.duration > 0.5]
    step = carrying[round(part * (len(carrying) - 1))]
    moving = next(arm for arm in ARMS if step.arms[arm].moves)
    speed = settings.speed_in(step)
    with physical_cell(schedule) as physics, lock_step(schedule) as clock:
        clock.physics = physics
        site = Cell(schedule, clock, {arm: clock.connect(hosts()[arm]) for arm in ARMS}, io.StringIO())
        log = ExecutionLog(site.log, clock)
        done: list[float] = []

        def act() -> None:
            done.append(clock.now())
            if protective:
                clock.stand_ins[moving].tell(protective_stop="by a test")
            else:
                executor.ask_to_stop()

        def confirm(begins: ProgramStep | None) -> bool:
            if begins is not None and begins.number == step.number:
                clock.at(clock.now() + 0.5 * step.duration / speed, act)
            return True

        executor = Executor(schedule, site.links, log, confirm, settings)
        ended = executor.run()
        assert ended.stop is not None
        assert ended.stop.reason is (StopReason.PROTECTIVE_STOP if protective else StopReason.ASKED)
        assert ended.step == step.number
        clock.sleep(1.0)
        for arm in ARMS:
            assert clock.stand_ins[arm].recording().still_since() - done[0] < STANDSTILL
        return physics.gave_way
