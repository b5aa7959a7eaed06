"""A lifter that raises a plate on a spring, and what two controllers' wrists feel of that.

It stands in for physics where only the vertical matters: what the spring does not bear the two hands do, each half, and
what their motion accelerates they feel.
"""

from __future__ import annotations

import math
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

from .lock_step import Told

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
    """Rises by a law of its own from when both programs have begun the lift, and tells both wrists what is left.

    It is the physics of a `LockStep`.
    """

    def __init__(self, schedule: Schedule, winch: WinchProfile, lets_go: float = math.inf) -> None:
        """Stand beside two arms.

        Args:
            schedule: with a lift at its end.
            winch: how it rises after the lift began.
            lets_go: after which its cup holds the plate no more [s].
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
        self._winch, self._lets_go = winch, lets_go
        plate = schedule.plan.bodies["plate"]
        assert plate.mass is not None
        self._weight = plate.mass * float(np.linalg.norm(schedule.plan.cell.gravity))
        self.samples: list[LiftSample] = []
        self._begun: tuple[float, float] | None = None

    def __call__(self, now: float, told: Told) -> dict[ArmName, dict[str, Any]]:
        """Return what both wrists feel, given the time and what both controllers told."""
        force = self._law.goal_force
        if any(each["output_int"][Registers().step] != self._step for each in told.values()):
            self._begun = None
        else:
            height, speed = self._motion(told)
            self._begun = self._begun or (now, height)
            force = self._force(now - self._begun[0], height - self._begun[1], speed)
        return {arm: {"wrench": self._wrench(arm, 0.5 * force)} for arm in ARMS}

    def _force(self, elapsed: float, followed: float, speed: float) -> float:
        """Return what both hands bear now [N]."""
        risen, rate = self._winch.at(elapsed)
        force = self._law.goal_force - self._stiffness * (risen - followed) - self._damping * (rate - speed)
        if elapsed > self._lets_go:
            force = self._weight
        if self.samples and elapsed > (last := self.samples[-1]).time:
            force += self._law.carried * (speed - last.speed) / (elapsed - last.time)
        # The hands cannot pull: where the lifter is far ahead they bear nothing.
        force = max(0.0, force)
        self.samples.append(LiftSample(elapsed, risen, followed, speed, force))
        return force

    def _motion(self, told: Told) -> tuple[float, float]:
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
