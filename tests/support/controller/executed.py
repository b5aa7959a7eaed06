"""What is executed on two stand-in controllers, and how far it is off what was planned."""

from __future__ import annotations

import io
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from planners.contract.arrays import ArmName
from planners.plan.scenery import ARMS
from planners.program.schedule import ProgramStep, Schedule
from planners.program.urscript import SETTLING, ProgramState
from workers.robot.arm_link import ArmLink
from workers.robot.execution_log import ExecutionLog
from workers.robot.executor import Confirm, Execution, ExecutionSettings, Executor

from .lock_step import LockStep, lock_step
from .physical_cell import TAKING_ON, PhysicalCell
from .site import CYCLE
from .stand_in import Recording, StandIn, hosts

Recordings = Mapping[ArmName, Recording]
STANDSTILL = 0.1
"""In which both arms must stand still, whatever happens [s]."""


@dataclass
class Cell:
    """Two controllers on one clock, and what is executed on them."""

    schedule: Schedule
    clock: LockStep
    links: Mapping[ArmName, ArmLink]
    log: io.StringIO

    @property
    def stand_ins(self) -> Mapping[ArmName, StandIn]:
        return self.clock.stand_ins

    def execute(
        self, confirm: Confirm = lambda _: True, schedule: Schedule | None = None, **settings: Any
    ) -> Execution:
        log = ExecutionLog(self.log, self.clock)
        return Executor(schedule or self.schedule, self.links, log, confirm, ExecutionSettings(**settings)).run()

    def events(self) -> list[dict[str, Any]]:
        return [line for line in map(json.loads, self.log.getvalue().splitlines()) if "event" in line]


def curve(schedule: Schedule, arm: ArmName, step: int) -> Callable[[np.ndarray], np.ndarray]:
    """Return what a plan has an arm do in a step, by SciPy."""
    mine = schedule.steps[step - 1].arms[arm]
    if not mine.moves:
        return lambda times: np.repeat(mine.positions, len(times), axis=0)
    return CubicHermiteSpline(mine.time, mine.positions, mine.velocities)


def assert_as_planned(schedule: Schedule, recordings: Recordings) -> None:
    """Recorded joints are within 1e-3 rad and one cycle of the plan, in each of its steps."""
    for arm, recording in recordings.items():
        for step in schedule.steps:
            assert off_plan(schedule, arm, step, recording) < 1e-3


def off_plan(schedule: Schedule, arm: ArmName, step: ProgramStep, recording: Recording) -> float:
    """Return how far a joint is off the plan within a cycle, at most in a step [rad]."""
    rows = running(recording, step.number)
    assert rows.any()
    times = recording.path_time[rows]
    # The joints are sent a cycle before the path's time goes on.
    off = [
        np.abs(curve(schedule, arm, step.number)(np.clip(times - late, 0.0, step.duration)) - recording.q[rows]).max(
            axis=1
        )
        for late in np.linspace(0.0, CYCLE, 5)
    ]
    return float(np.min(off, axis=0).max())


def apart(recordings: Recordings, step: int) -> np.ndarray:
    """Return by how much the arms are apart on the plan's clock in a step, cycle by cycle [s]."""
    left, right = (recordings[arm] for arm in ARMS)
    mine, other = running(left, step), running(right, step)
    return np.abs(np.interp(left.time[mine], right.time[other], right.path_time[other]) - left.path_time[mine])


def running(recording: Recording, step: int) -> np.ndarray:
    return (recording.step == step) & (recording.state == ProgramState.RUNNING)


def executed(
    schedule: Schedule, physics: PhysicalCell, seconds: float
) -> tuple[Execution, Mapping[ArmName, Recording]]:
    """Execute a plan in a world at its own speed, and follow its lifter for so long after it, if a lift follows."""
    with lock_step(schedule) as clock:
        links = {arm: clock.connect(hosts()[arm]) for arm in ARMS}
        clock.physics = physics

        def confirm(step: ProgramStep | None) -> bool:
            # A stray key before the lift: it ends nothing.
            executor.end_lift()
            if step is None:
                # The lift begins a few cycles after it was confirmed.
                clock.at(clock.now() + TAKING_ON * SETTLING + seconds + 0.1, executor.end_lift)
            return True

        settings = ExecutionSettings(stops_may_drop=True)
        executor = Executor(schedule, links, ExecutionLog(io.StringIO(), clock), confirm, settings)
        execution = executor.run()
        return execution, {arm: clock.stand_ins[arm].recording() for arm in ARMS}
