"""One run: the whole manipulation first, then the cooperative lift, until it is done or something gives way."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from planners.geometry.pose import Array, rotation_angle
from planners.progress import Progress, Report
from planners.scene.lift_scene import PlateLiftScene
from workers.simulation.cooperative_lift import CooperativeLift, LiftForces, way_up
from workers.simulation.hands import GrippingHand, PushingHand, SimulatedHand
from workers.simulation.lifter import SuctionLifter
from workers.simulation.node_forces import NodeForcesRecorder
from workers.simulation.outcome import Failure, SimulationOutcome
from workers.simulation.recorder import Recorder
from workers.simulation.reference import Moment, PlanReference, Stage
from workers.simulation.settings import SimulationSettings, WinchSettings
from workers.simulation.watch import Watch
from workers.simulation.world import World

_REPORT_EVERY = 50
"""Steps between two reports of progress."""


class Execution:
    """One simulated run of a plan. Call `run` once."""

    def __init__(
        self,
        document: Mapping[str, Any],
        scene: PlateLiftScene,
        world: World,
        settings: SimulationSettings,
        rng: np.random.Generator,
        known: PlateLiftScene,
    ) -> None:
        """Prepare hands, cup and what the plan wants.

        Args:
            document: solved.
            scene: as everything really is.
            world: the physics, at the start.
            settings: see there.
            rng: sensor noise, the lifter's force error, and the winch.
            known: the scene that it was planned in, and that the lift is prepared for.
        """
        self.scene, self.world, self.settings, self._rng = scene, world, settings, rng
        self._known = known
        self.reference = PlanReference.of(document, scene.cup.T_plate_cup[:3, 3])
        friction = scene.friction
        grip_arm, push_arm = scene.cell.gripper_arms[0], scene.cell.pusher_arms[0]
        first = {name: 6 * i for i, name in enumerate(scene.cell.arms)}
        arms = scene.cell.arms
        self.gripping = GrippingHand(
            arms[grip_arm], first[grip_arm], settings, rng, (friction.grip, friction.eps), scene.plate.height
        )
        self.pushing = PushingHand(arms[push_arm], first[push_arm], settings, rng, friction.push, scene.plate.com)
        self.hands: tuple[SimulatedHand, ...] = (self.gripping, self.pushing)
        self.lifter = SuctionLifter(scene, settings.cup, settings.contact, rng)
        self.recorder = Recorder()
        self.comparison = NodeForcesRecorder(settings.step)
        self.motion: list[tuple[float, Array, Array]] = []
        """Time, joint positions and plate pose, at the recorder's times."""
        self.largest_way_off = np.zeros(2)
        """Of the plate during the manipulation: distance of the cup's place [m] and angle [rad]."""
        self.lift: CooperativeLift | None = None
        self.time = 0.0
        self._watch = Watch(self.lifter, self.gripping, self.pushing, scene.hand_force_limit.net, settings)
        self._place0, self._R0 = np.zeros(3), np.eye(3)
        self._tick = round(settings.sensor.period / settings.step)
        self._record = round(settings.record_period / settings.step)
        self._steps = 0
        self._corrections = np.zeros(12)

    def run(self, progress: Progress) -> Failure[SimulationOutcome] | None:
        """Execute everything; return what gave way, None when the plate was lifted."""

        def report() -> None:
            if self._steps % _REPORT_EVERY == 0:
                progress(Report("simulate", round(1000.0 * self._part_done()), 1000))

        failure = self._manipulate(report) or self._settle(report) or self._follow(report)
        progress(Report("simulate", 1, 1))
        return failure

    def prepare(self) -> Failure[SimulationOutcome] | None:
        """Execute everything until the lifter begins to rise; return what gave way, None when the plate hangs still."""
        return self._manipulate(_untold) or self._settle(_untold)

    def lift_behind(self, winch: WinchSettings, seed: int) -> Failure[SimulationOutcome] | None:
        """After `prepare`: lift behind a lifter that is drawn anew; return what gave way, None when lifted."""
        lift = self.lift
        assert lift is not None
        self._rng.bit_generator.state = np.random.default_rng(seed).bit_generator.state
        self.settings = replace(self.settings, winch=winch)
        self.lift = CooperativeLift(self._known, lift.forces, lift.path, self.time, self.settings, self._rng)
        return self._follow(_untold)

    def _part_done(self) -> float:
        """Return how much is done: half of it until the lift, whose length is not known before, and half for it."""
        if self.lift is None:
            return 0.5 * self.time / (self.reference.duration + self.settings.settle)
        return 0.5 + 0.5 * (self.time - self.lift.begin) / (self.lift.end - self.lift.begin)

    def _manipulate(self, report: Callable[[], None]) -> Failure[SimulationOutcome] | None:
        while self.time < self.reference.duration - 0.5 * self.settings.step:
            moment = self.reference.at(self.time)
            failure = self._manipulate_step(moment, {name: moment.wrench(name) for name in ("left", "right", "cup")})
            if failure is not None:
                return failure
            if self.comparison.due(self.time, moment):
                self.comparison.take(self.time, moment, self._forces())
            report()
        return None

    def _settle(self, report: Callable[[], None]) -> Failure[SimulationOutcome] | None:
        """Let the hands take on the goal forces of the lift while the plate hangs still, and prepare the lift."""
        moment = self.reference.at(self.reference.duration)
        com = self.scene.plate.com
        forces = LiftForces.find(self._known, moment.rotation_world_plate, self.gripping, self.pushing, com)
        if forces is None:
            return Failure(SimulationOutcome.OVERLOAD, self.time, "hands and cup cannot bear the plate in the air")
        begin, seconds = self.time, self.settings.settle
        first = {name: moment.wrench(name) for name in forces.wrenches}
        while self.time < begin + seconds - 0.5 * self.settings.step:
            part = min(1.0, 2.0 * (self.time - begin) / seconds)
            wanted = {name: _blend(first[name], wrench, part) for name, wrench in forces.wrenches.items()}
            failure = self._manipulate_step(moment, wanted)
            if failure is not None:
                return failure
            report()
        self._prepare_lift(forces, moment)
        return None

    def _manipulate_step(self, moment: Moment, wanted: Mapping[str, Array | None]) -> Failure[SimulationOutcome] | None:
        """Take one step along the plan with the wrenches (6,) that arms and "cup" are told to exert."""
        plate, step = self.world.plate_motion(), self.settings.step
        ahead = self.reference.at(self.time + step)
        if self._steps % self._tick == 0:
            for hand in self.hands:
                hand.track(wanted[hand.arm.name], moment.rotation_world_plate)
                self._corrections[hand.joints] = hand.correction(ahead.positions[hand.joints])
                hand.sense(plate[0])
        cup = wanted["cup"]
        assert cup is not None
        wrench = self.lifter.give(cup, moment.cup_point, moment.cup_velocity, plate, step)
        failure = self._step(ahead.positions + self._corrections, ahead.velocities, wrench, moment.stage)
        if self._steps % self._record == 0:
            self._record_row(0.0, 0.0, 0.0)
            self._note_way_off(moment)
        return failure

    def _prepare_lift(self, forces: LiftForces, moment: Moment) -> None:
        """Hang the plate on the winch as everything is now."""
        T_world_plate = moment.reference.T_world_plate[moment.low]
        arms = (self.gripping.arm.name, self.pushing.arm.name)
        path = way_up(self.scene, moment.positions, self._corrections, T_world_plate, arms)
        self.lift = CooperativeLift(self._known, forces, path, self.time, self.settings, self._rng)
        plate = self.world.plate_motion()
        self.lifter.hang(plate, forces.wrenches["cup"][3:])
        self._place0, self._R0 = self.lifter.place(plate)[0], plate[0]

    def _follow(self, report: Callable[[], None]) -> Failure[SimulationOutcome] | None:
        """Let the winch go up, and the hands after it."""
        lift = self.lift
        assert lift is not None
        while self.time < lift.end:
            if self._steps % self._tick == 0:
                # The law gets the reading before: it takes one period from the sensor to the arms.
                lift.command(sum(float(hand.reading[2]) for hand in self.hands))
                rotation = self.world.plate_motion()[0]
                for hand in self.hands:
                    hand.sense(rotation)
            height, speed = lift.lifter(self.time)
            wrench = self.lifter.hoist(height, speed, self.world.plate_motion())
            failure = self._step(*lift.advance(self.settings.step), wrench, self.reference.stages[-1])
            if failure is not None:
                return failure
            if self._steps % self._record == 0:
                self._record_row(lift.velocity, speed, height)
            report()
        return None

    def _step(
        self, positions: Array, velocities: Array, cup_wrench: Array, stage: Stage
    ) -> Failure[SimulationOutcome] | None:
        """Let hands and cup act for one step, drive the joints, and look for what gave way."""
        world = self.world
        plate = world.plate_motion()
        total = cup_wrench.copy()
        for hand in self.hands:
            T_world_hand, twist = world.hand(hand.arm.name, hand.T_flange_hand)
            hand.update(stage, self.time, T_world_hand, plate)
            wrench = hand.touch.act(T_world_hand, twist, plate)
            world.push_hand(hand.arm.name, -wrench, plate[1])
            total += wrench
        world.push_plate(total)
        world.drive(positions, velocities)
        world.advance()
        self.time += self.settings.step
        self._steps += 1
        turned = 0.0 if self.lift is None else rotation_angle(self._R0, world.plate_motion()[0])
        return self._watch.look(stage, self.time, turned)

    def _forces(self) -> dict[str, Array]:
        """Return the force (3,) on the plate of everything that touches it, by who exerts it [N]."""
        hands = {hand.arm.name: hand.force for hand in self.hands}
        return hands | {"cup": self.lifter.force, "support": self.world.resting_force()}

    def _note_way_off(self, moment: Moment) -> None:
        plate = self.world.plate_motion()
        off = float(np.linalg.norm(self.lifter.place(plate)[0] - moment.cup_point))
        turned = rotation_angle(moment.rotation_world_plate, plate[0])
        self.largest_way_off = np.maximum(self.largest_way_off, [off, turned])

    def _record_row(self, velocity: float, lifter_velocity: float, lifter_height: float) -> None:
        plate = self.world.plate_motion()
        push, grip = float(self.pushing.force[2]), float(self.gripping.force[2])
        height = 0.0 if self.lift is None else float(self.lifter.place(plate)[0][2] - self._place0[2])
        self.recorder.add(
            self.time,
            pushing_hand=push,
            gripping_hand=grip,
            both_hands=push + grip,
            suction_load=self.lifter.pull,
            commanded_velocity=velocity,
            lifter_velocity=lifter_velocity,
            plate_height=height,
            lifter_height=lifter_height,
            plate_tilt=float(np.degrees(np.arccos(np.clip(plate[0][2, 2], -1.0, 1.0)))),
        )
        self.motion.append((self.time, self.world.positions.copy(), self.world.plate_pose()))


def _untold() -> None:
    """Tell nobody how far it is."""


def _blend(first: Array | None, last: Array, part: float) -> Array:
    """Return what lies between two wrenches; a hand that bore nothing begins with nothing."""
    return part * last if first is None else (1.0 - part) * first + part * last
