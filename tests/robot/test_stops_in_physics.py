"""Shipped plans stopped midway on two stand-in controllers in physics: nothing is dropped that need not be."""

from __future__ import annotations

import io
from contextlib import ExitStack

import pytest

from planners.plan.scenery import ARMS
from planners.plan.segment import SegmentKind
from planners.program.schedule import ProgramStep, Schedule
from tests.support.controller.executed import STANDSTILL, Cell
from tests.support.controller.lock_step import lock_step
from tests.support.controller.physical_cell import PhysicalPile, physical_cell
from tests.support.controller.stand_in import hosts
from tests.support.documents import plan_of
from tests.support.plan_shelf import PlanShelf
from tests.support.service import task
from workers.robot.execution_log import ExecutionLog
from workers.robot.executor import ExecutionSettings, Executor
from workers.robot.supervision import StopReason


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
    """Stop both arms in the middle of a step in which something is carried; returns what gave way.

    Of a pile no more is executed than that step and the one before it.
    """
    schedule = Schedule.of(plan_of(shelf.document(task(name))))
    carrying = [step for step in schedule.steps if step.kind is SegmentKind.TRANSFER and step.duration > 0.5]
    step = carrying[round(part * (len(carrying) - 1))]
    moving = next(arm for arm in ARMS if step.arms[arm].moves)
    speed = settings.speed_in(step)
    with ExitStack() as stack:
        physics = stack.enter_context(physical_cell(schedule))
        if isinstance(physics, PhysicalPile):
            schedule = physics.prepare(max(schedule.steps[0].number, step.number - 1))
        clock = stack.enter_context(lock_step(schedule))
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
