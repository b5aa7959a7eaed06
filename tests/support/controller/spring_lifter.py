"""A lifter that raises a plate on a spring, and what two controllers' wrists feel of that.

It stands in for physics where only the vertical matters: what the spring does not bear the two hands do, each half, and
what their motion accelerates they feel.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np

from planners.contract.arrays import ArmName
from planners.contract.task_spec import PlateLiftTask
from planners.kinematics.forward import flange_pose
from planners.plan.scenery import ARMS, ArmDocument
from planners.program.schedule import Schedule
from planners.program.urscript import Registers
from workers.simulation.lifter import WinchProfile
from workers.simulation.settings import SimulationSettings

from .stand_in import StandIn

PERIOD = 0.01
"""Between two readings of the wrists [s]."""
_MOMENT = 1e-4
"""Over which a hand's speed is seen [s]."""


@dataclass(frozen=True)
class LiftSample:
    """What lifter and hands do at a moment."""

    time: float
    """Of the lift [s]."""
    risen: float
    """The lifter [m]."""
    followed: float
    """The hands, in the mean [m]."""
    speed: float
    """Of the hands, upward [m/s]."""
    force: float
    """That both hands exert [N]."""


class SpringLifter:
    """Rises by a law of its own from when both programs have begun the lift, and tells both wrists what is left."""

    def __init__(
        self,
        schedule: Schedule,
        stand_ins: Mapping[ArmName, StandIn],
        winch: WinchProfile,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Stand beside two controllers.

        Args:
            schedule: with a lift at its end.
            stand_ins: controllers of both arms.
            winch: how it rises after the lift began.
            clock: of the controllers [s].
        """
        lift, task = schedule.lift, schedule.plan.task
        assert lift is not None
        assert lift.lift is not None
        assert lift.lift.law is not None
        assert isinstance(task, PlateLiftTask)
        cup = SimulationSettings().cup
        self._law, self._step = lift.lift.law, schedule.last + 1
        self._stiffness = cup.stiffness(task.cup.max_force)
        self._damping = cup.damping_time * self._stiffness
        self._arms = {arm: schedule.plan.cell.arms[arm] for arm in ARMS}
        self._stand_ins, self._winch, self._clock = stand_ins, winch, clock
        self.samples: list[LiftSample] = []
        self._over = threading.Event()

    @contextmanager
    def at_work(self) -> Iterator[SpringLifter]:
        """Have it act until the block ends."""
        thread = threading.Thread(target=self._run, name="lifter", daemon=True)
        thread.start()
        try:
            yield self
        finally:
            self._over.set()
            thread.join()

    def _run(self) -> None:
        begun, begins, force = None, 0.0, self._law.goal_force
        while not self._over.wait(PERIOD):
            told = {arm: self._stand_ins[arm].tell(wrench=self._wrench(arm, 0.5 * force)) for arm in ARMS}
            if any(each["output_int"][Registers().step] != self._step for each in told.values()):
                begun, force = None, self._law.goal_force
                continue
            now, (height, speed) = self._clock(), self._motion(told)
            if begun is None:
                begun, begins = now, height
            force = self._force(now - begun, height - begins, speed)

    def _force(self, elapsed: float, followed: float, speed: float) -> float:
        """Return what both hands bear now [N]."""
        risen, rate = self._winch.at(elapsed)
        force = self._law.goal_force - self._stiffness * (risen - followed) - self._damping * (rate - speed)
        if self.samples and elapsed > (last := self.samples[-1]).time:
            force += self._law.carried * (speed - last.speed) / (elapsed - last.time)
        # The hands cannot pull: where the lifter is far ahead they bear nothing.
        force = max(0.0, force)
        self.samples.append(LiftSample(elapsed, risen, followed, speed, force))
        return force

    def _motion(self, told: Mapping[ArmName, Mapping[str, Any]]) -> tuple[float, float]:
        """Return height and upward speed of both hands in the mean [m, m/s]."""
        heights, speeds = [], []
        for arm, each in told.items():
            q, qd = np.array(each["joints"]), np.array(each["velocities"])
            heights.append(_height(self._arms[arm], q))
            speeds.append((_height(self._arms[arm], q + _MOMENT * qd) - heights[-1]) / _MOMENT)
        return float(np.mean(heights)), float(np.mean(speeds))

    def _wrench(self, arm: ArmName, force: float) -> list[float]:
        """Return what a wrist feels that bears a force, in the arm's base frame."""
        return [*(-force * self._arms[arm].T_world_base[2, :3]).tolist(), 0.0, 0.0, 0.0]


def _height(arm: ArmDocument, q: np.ndarray) -> float:
    return float(flange_pose(arm.dh, arm.T_world_base, q)[2, 3])
