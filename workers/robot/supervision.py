"""What is wrong with two arms that run a plan, if anything: judged from what both told last."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from planners.contract.arrays import ArmName
from planners.geometry.pose import Array, rotation_angle
from planners.kinematics.forward import flange_pose_of_plan
from planners.lifting.hand_admittance import HandAdmittance
from planners.program.schedule import ArmStep, Schedule
from planners.program.urscript import APART_IN_LIFT, BEARING_TOLERANCE, ProgramState
from workers.robot.arm_link import NORMAL_MODES, ArmState


class StopReason(StrEnum):
    """Why both arms were stopped; the value is what a person is told."""

    LOST = "a controller told nothing any more"
    PROTECTIVE_STOP = "a controller stopped its arm for protection"
    ENDED = "a program ended before the plan did"
    WRONG_START = "an arm is not where the plan begins"
    OVERLOAD = "more force at a wrist than the plan allows"
    DEVIATION = "an arm is not where the plan has it"
    APART = "the arms are not at the same time of the plan, or do not rise alike"
    LATE = "this computer looks at the arms too late"
    ASKED = "somebody asked to stop"


@dataclass(frozen=True)
class SupervisionSettings:
    """What is too much."""

    silence: float = 0.02
    """A controller that tells nothing new for longer counts as lost: ten cycles of an e-Series [s]."""
    late: float = 0.04
    """Between two looks at the arms, or since either told something new: below that at which programs stop by
    themselves, see `HEARTBEAT_RATE` [s]."""
    deviation: float = 0.03
    """Of a joint from the plan: what an arm at full speed moves in a few control cycles [rad]."""
    bearing_distance: float = HandAdmittance.largest_correction + 0.01
    """Of a hand's TCP from the plan of a lift, in which it gives way to what it feels [m]."""
    bearing_angle: float = HandAdmittance.largest_turning + 0.03
    """Likewise [rad]."""
    letting_go: float = 1.0
    """How long after it let go a hand may still be off so far, on the plan's clock [s]."""
    apart: float = 0.1
    """Between the times of the plan at which both arms are [s]."""
    pull: float = 8.0
    """By what share an arm is slowed for each second by which it is ahead of the other [1/s]."""


@dataclass(frozen=True)
class Stop:
    """Why, and which arm it was."""

    reason: StopReason
    arm: ArmName | None


@dataclass(frozen=True, eq=False)
class ArmSupervisor:
    """Compares what arms tell with a schedule."""

    schedule: Schedule
    settings: SupervisionSettings

    def __post_init__(self) -> None:
        # Compiled code is loaded by its first call, which takes longer than arms in motion may be left alone.
        for described in self.schedule.plan.cell.arms.values():
            flange_pose_of_plan(described.dh, described.T_world_base, np.zeros(6))

    def fault(self, states: Mapping[ArmName, ArmState], silences: Mapping[ArmName, float]) -> Stop | None:
        """Return the first thing that is wrong.

        Args:
            states: of each arm, as told last.
            silences: for how long each has told nothing new [s].
        """
        for arm, state in states.items():
            reason = self._fault_of(arm, state, silences[arm])
            if reason is not None:
                return Stop(reason, arm)
        if abs(self.lead(states)) > self.settings.apart:
            return Stop(StopReason.APART, None)
        left, right = states["left"], states["right"]
        if left.step == right.step > self.schedule.last and left.state == right.state == ProgramState.RUNNING:
            if abs(left.lift_height - right.lift_height) > APART_IN_LIFT:
                return Stop(StopReason.APART, None)
        return None

    def lead(self, states: Mapping[ArmName, ArmState]) -> float:
        """Return by how much the left arm is ahead of the right one in a step that both are in [s]."""
        left, right = states["left"], states["right"]
        if left.step != right.step or not left.state == right.state == ProgramState.RUNNING:
            return 0.0
        return left.path_time - right.path_time

    def expected(self, arm: ArmName, state: ArmState) -> Array | None:
        """Return the (6,) joint positions that the plan has where an arm says to be; None outside of it [rad]."""
        step = self.schedule.step(state.step)
        return None if step is None else step.arms[arm].curve(np.clip(state.path_time, 0.0, step.duration))

    def _fault_of(self, arm: ArmName, state: ArmState, silence: float) -> StopReason | None:
        settings = self.settings
        if silence > settings.silence:
            return StopReason.LOST
        if state.safety_mode not in NORMAL_MODES:
            return StopReason.PROTECTIVE_STOP
        told = _TOLD.get(state.state)
        if told is not None:
            return told
        if not state.is_playing and state.state is not ProgramState.DONE:
            return StopReason.ENDED
        if state.state is not ProgramState.RUNNING:
            return None
        # In the lift, which follows the last step, that step's limit stays.
        step = self.schedule.step(state.step) or self.schedule.steps[-1]
        if float(np.linalg.norm(state.force)) > step.arms[arm].force_limit:
            return StopReason.OVERLOAD
        expected = self.expected(arm, state)
        if expected is not None and self._deviates(arm, step.arms[arm], expected, state):
            return StopReason.DEVIATION
        return None

    def _deviates(self, arm: ArmName, step: ArmStep, expected: Array, state: ArmState) -> bool:
        """Tell whether joints are too far from those (6,) that the plan has [rad]."""
        positions = state.positions
        most = float(np.abs(expected - positions).max())
        if most <= self.settings.deviation:
            return False
        lets_go = not step.free and state.path_time < self.settings.letting_go
        holds = step.wrenches is not None and (step.wrenches.bears or lets_go)
        if not holds or most > BEARING_TOLERANCE:
            return True
        described = self.schedule.plan.cell.arms[arm]
        T_planned, T_told = (
            flange_pose_of_plan(described.dh, described.T_world_base, q) @ step.T_flange_tcp
            for q in (expected, positions)
        )
        return (
            float(np.linalg.norm(T_planned[:3, 3] - T_told[:3, 3])) > self.settings.bearing_distance
            or rotation_angle(T_planned[:3, :3], T_told[:3, :3]) > self.settings.bearing_angle
        )


_TOLD = {
    ProgramState.WRONG_START: StopReason.WRONG_START,
    ProgramState.OVERLOAD: StopReason.OVERLOAD,
    ProgramState.STOPPED: StopReason.ASKED,
}
