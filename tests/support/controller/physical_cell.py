"""What two controllers move, in one world: both arms and all that they touch in PyBullet, and what wrists feel of it.

The world is that in which plans are simulated, with its contacts, holds, cup and lifter. Only what drives it is
another: joints go where the controllers have them, and of the programs nothing is known but the step that they
tell, and the time in it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np

from planners.contract.arrays import ArmName
from planners.geometry.pose import Array
from planners.plan.scenery import ARMS
from planners.plan.segment import SegmentKind
from planners.program.schedule import Schedule
from planners.program.urscript import SETTLING, Registers
from planners.scene.lift_scene import PlateLiftScene
from planners.scene.scene import build_scene
from planners.scene.tool_scene import SuctionToolScene
from workers.simulation.cooperative_lift import LiftForces
from workers.simulation.hands import SimulatedHand
from workers.simulation.lift_execution import LiftExecution
from workers.simulation.lifter import WinchProfile
from workers.simulation.settings import SimulationSettings, ToolSimulationSettings
from workers.simulation.timeline import PlannedMoment
from workers.simulation.tool_execution import ToolExecution
from workers.simulation.world import LiftWorld, Motion, ToolWorld

from .lock_step import Told

_TOLD = Registers()
TAKING_ON = 1.2
"""How long the lifter waits for hands to take on the forces of the lift, over the time that they are told to take."""
_FARTHER = 0.01
"""How much higher than the hands a lifter rises that goes beyond their reach [m]."""
_COMPARED = 10
"""Control cycles between two moments at which forces are compared with the plan's."""


@dataclass(frozen=True)
class LiftSample:
    """What lifter and hands do at a moment of the lift."""

    time: float
    """Since the lifter began to rise [s]."""
    risen: float
    """The lifter [m]."""
    followed: float
    """The plate at its cup [m]."""
    pull: float
    """On the cup [N]."""
    force: float
    """That both hands exert upward [N]."""


class PhysicalLift:
    """The world of a plate lift, and who raises its lifter."""

    def __init__(
        self,
        schedule: Schedule,
        scene: PlateLiftScene,
        world: LiftWorld,
        seed: int,
        lets_go: float = math.inf,
        *,
        beyond_reach: bool = False,
    ) -> None:
        """Stand where the plan begins.

        Args:
            schedule: of the plan, that is executed.
            scene: that it was planned in.
            world: the physics, at the start.
            seed: of the winch, of what the lifter gives too much, and of the wrists' noise.
            lets_go: after which of the lift the cup has no vacuum any more [s].
            beyond_reach: whether the lifter goes on where the hands end, which ends the lift; else it stops below.
        """
        self.schedule, self._scene, self.world, self._lets_go = schedule, scene, world, lets_go
        settings, rng = SimulationSettings.of(scene), np.random.default_rng(seed)
        self.execution = LiftExecution(schedule.plan, scene, world, settings, rng, scene)
        lift = schedule.lift
        travel = 0.0
        if lift is not None and lift.lift is not None:
            travel = lift.lift.reachable_height + _FARTHER if beyond_reach else lift.lift.lifter_travel
        self._winch = WinchProfile.draw(travel, settings.step, rng, settings.winch)
        self._rng, sensor = rng, settings.sensor
        self._noise = np.repeat([sensor.force_noise, sensor.torque_noise], 3)
        bias = np.repeat([sensor.force_bias, sensor.torque_bias], 3)
        self._offsets = {hand.arm.name: rng.normal(scale=bias) for hand in self.execution.hands}
        self.samples: list[LiftSample] = []
        self.untracked: dict[tuple[ArmName, int], list[float]] = {}
        """By arm and step: forces on the plate less those that are planned, in norm, at some moments [N]."""
        self.gave_way: str | None = None
        """What did, once it has."""
        self._forces: LiftForces | None = None
        """Of the lift, once both programs have begun it."""
        self._cycles = 0
        self.begun, self._height = 0.0, math.nan
        """When the lifter begins to rise, on the clock [s]."""

    def prepare(self) -> dict[ArmName, Array]:
        """Have the simulation's own hands do all until the lift; returns where the joints are then, by arm [rad]."""
        failure = self.execution.prepare()
        assert failure is None, failure
        self.execution.lift = None
        # Wrists were tared before the hands touched anything.
        self._offsets = {hand.arm.name: np.zeros(6) for hand in self.execution.hands}
        return {arm: self.world.positions[part].copy() for arm, part in _PARTS.items()}

    def __call__(self, now: float, told: Told) -> dict[ArmName, dict[str, Any]]:
        """Let a control cycle pass, given the time and what controllers tell; returns what both wrists feel."""
        if self.gave_way is None and set(told) == set(ARMS):
            self._pass(now, told)
        hands = [hand for hand in self.execution.hands if hand.arm.name in told]
        return {hand.arm.name: {"wrench": self._felt(hand, told[hand.arm.name])} for hand in hands}

    def _pass(self, now: float, told: Told) -> None:
        execution, schedule = self.execution, self.schedule
        positions, velocities = _joints(told)
        lifts = all(each["output_int"][_TOLD.step] > schedule.last for each in told.values())
        moment = execution.reference.at(_clock(schedule, told))
        if lifts and self._forces is None:
            rotation = execution.reference.plate_rotation(moment)
            self._forces = LiftForces.find(
                self._scene, rotation, execution.gripping, execution.pushing, self._scene.plate.com
            )
            assert self._forces is not None
            # The hands take on the forces of the lift meanwhile.
            self.begun = now + TAKING_ON * SETTLING
        plate, lifter = self.world.plate.motion, execution.lifter
        elapsed = now - self.begun
        if self._forces is None or elapsed < 0.0:
            planned = execution.reference.wrench("cup", moment)
            assert planned is not None
            if self._forces is not None:
                part = min(1.0, 2.0 * (elapsed / SETTLING + TAKING_ON))
                planned = (1.0 - part) * planned + part * self._forces.wrenches["cup"]
            wrench = lifter.give(
                planned, execution.reference.cup_point(moment), execution.reference.cup_velocity(moment), plate,
                execution.settings.step,
            )  # fmt: skip
        else:
            if math.isnan(self._height):
                lifter.hang(plate, self._forces.wrenches["cup"][3:])
                self._height = float(lifter.place(plate)[2])
            wrench = lifter.hoist(*self._winch.at(elapsed), plate)
            if elapsed > self._lets_go:
                wrench, lifter.pull = np.zeros(6), 0.0
        self._let_touch(moment, plate)
        self._cycles += 1
        if self._cycles % _COMPARED == 0:
            self._compare(told)
        failure = execution._step(positions, velocities, wrench, moment)
        self.gave_way = None if failure is None else failure.cause
        if not math.isnan(self._height):
            force = sum(float(hand.force[2]) for hand in execution.hands)
            followed = float(lifter.place(self.world.plate.motion)[2]) - self._height
            self.samples.append(LiftSample(elapsed, self._winch.at(elapsed)[0], followed, lifter.pull, force))

    def _compare(self, told: Told) -> None:
        """Keep how far the hands' forces are from those that the plan has where the programs are."""
        for hand in self.execution.hands:
            arm, number = hand.arm.name, told[hand.arm.name]["output_int"][_TOLD.step]
            step = self.schedule.step(number)
            curve = None if step is None else step.arms[arm].wrenches
            if step is None or curve is None or not curve.bears or curve.comes:
                continue
            path_time = min(told[arm]["output_float"][_TOLD.path_time], step.duration)
            planned = hand.arm.T_world_base[:3, :3] @ curve.at(np.array([path_time])).values[0, :3]
            self.untracked.setdefault((arm, number), []).append(float(np.linalg.norm(hand.force - planned)))

    def _let_touch(self, moment: PlannedMoment, plate: Motion) -> None:
        """Have a stick that comes touch the face when it meets it: the simulation has it do so once it has come."""
        segments, hand = self.execution.reference.segments, self.execution.pushing
        if moment.segment.kind is SegmentKind.APPROACH and moment.number + 1 < len(segments) and not hand.touch.engaged:
            ahead = segments[moment.number + 1]
            if moment.segment.push is None and ahead.push is not None:
                T_world_hand, _ = self.world.hand(hand.arm.name, hand.T_flange_hand)
                hand.update(moment._replace(segment=ahead), T_world_hand, plate)

    def _felt(self, hand: SimulatedHand, told: Any) -> list[float]:
        """Return what a wrist feels about its flange, base axes, beyond the payload that its controller was told."""
        name, T_world_base = hand.arm.name, hand.arm.T_world_base
        wrench = -hand.touch.wrench(self.world.plate.motion[:3])
        T_world_hand, _ = self.world.hand(name, hand.T_flange_hand)
        lever = T_world_hand[:3, :3] @ (hand.T_flange_hand[:3, 3] @ hand.T_flange_hand[:3, :3])
        # Written out, it takes a tenth of the time of numpy's for arrays this small.
        (x, y, z), (u, v, w) = lever.tolist(), wrench[:3].tolist()
        wrench[3:] += (y * w - z * v, z * u - x * w, x * v - y * u)
        carried = told["payload"] - (self.schedule.plan.cell.hands[name].mass or 0.0)
        wrench[:3] -= carried * np.asarray(self._scene.cell.gravity)
        felt = (wrench.reshape(2, 3) @ T_world_base[:3, :3]).ravel()
        return (felt + self._offsets[name] + self._noise * self._rng.standard_normal(6)).tolist()


class PhysicalPile:
    """The world of a suction-tool plan."""

    def __init__(self, schedule: Schedule, scene: SuctionToolScene, world: ToolWorld) -> None:
        """Stand where the plan begins."""
        self._schedule, self._scene, self.world = schedule, scene, world
        self.execution = ToolExecution(schedule.plan, scene, world, ToolSimulationSettings())
        self._look = round(self.execution.settings.watch.period / self.execution.settings.step)
        self._cycles = 0
        self.gave_way: str | None = None
        """What did, once it has."""

    def prepare(self, number: int) -> Schedule:
        """Have the simulation's own arms do all until a step, by its number; returns the steps from there on."""
        self._schedule = self._schedule.since(number)
        step, execution = self.execution.settings.step, self.execution
        while execution.time < self._schedule.steps[0].begin - 0.5 * step:
            assert execution._step() is None
        return self._schedule

    def __call__(self, now: float, told: Told) -> dict[ArmName, dict[str, Any]]:
        """Let a control cycle pass, given what controllers tell; returns what both wrists feel."""
        execution = self.execution
        if self.gave_way is None and set(told) == set(ARMS):
            failure = execution._take_and_let_go(execution.timeline.at(_clock(self._schedule, told)))
            execution._advance(*_joints(told))
            self._cycles += 1
            if failure is None and self._cycles % self._look == 0:
                failure = execution._give_way()
            self.gave_way = None if failure is None else failure.cause
        return {arm: {"wrench": self._felt(arm, told[arm])} for arm in told}

    def _felt(self, arm: ArmName, told: Any) -> list[float]:
        """Return what a wrist feels beyond the payload that its controller was told, base axes."""
        hold, described = self.execution._fingers.get(arm), self._scene.cell.arms[arm]
        force = np.zeros(3)
        if hold is not None:
            carried = told["payload"] - (self._schedule.plan.cell.hands[arm].mass or 0.0)
            force = -hold.bond.wrench[:3] - carried * np.asarray(self._scene.cell.gravity)
        return [*(described.T_world_base[:3, :3].T @ force).tolist(), 0.0, 0.0, 0.0]


PhysicalCell = PhysicalLift | PhysicalPile


@contextmanager
def physical_cell(
    schedule: Schedule, seed: int = 0, lets_go: float = math.inf, *, beyond_reach: bool = False
) -> Iterator[PhysicalCell]:
    """Have the world of a plan's cell, to be the physics of a `LockStep`; arguments as of `PhysicalLift`."""
    scene = build_scene(schedule.plan.task)
    if isinstance(scene, SuctionToolScene):
        with ToolWorld(scene, ToolSimulationSettings()) as world:
            yield PhysicalPile(schedule, scene, world)
        return
    with LiftWorld(scene, SimulationSettings.of(scene)) as world:
        yield PhysicalLift(schedule, scene, world, seed, lets_go, beyond_reach=beyond_reach)


_PARTS = {arm: slice(6 * i, 6 * i + 6) for i, arm in enumerate(ARMS)}


def _joints(told: Told) -> tuple[Array, Array]:
    """Return positions and velocities (12,) of the joints of both arms [rad, rad/s]."""
    positions, velocities = (np.concatenate([told[arm][name] for arm in ARMS]) for name in ("joints", "velocities"))
    return positions, velocities


def _clock(schedule: Schedule, told: Told) -> float:
    """Return where both programs are on the plan's clock, in the mean [s]."""
    times = []
    for each in told.values():
        number = each["output_int"][_TOLD.step]
        step = schedule.step(number)
        if step is None:
            last = schedule.steps[-1]
            times.append(last.clock(last.duration) if number else schedule.steps[0].begin)
        else:
            times.append(step.clock(min(each["output_float"][_TOLD.path_time], step.duration)))
    return sum(times) / len(times)
