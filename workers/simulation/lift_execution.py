"""One run: the whole manipulation first, then the cooperative lift, until it is done or something gives way."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial

import numpy as np

from planners.geometry.pose import Array, Transform, rotation_angle
from planners.plan.plan import Plan
from planners.plan.segment import Segment, SegmentKind
from planners.plan.simulation import LiftEnding
from planners.progress import Progress, Report
from planners.scene.lift_scene import PlateLiftScene
from workers.simulation.cooperative_lift import CooperativeLift, LiftForces, way_up
from workers.simulation.hands import GrippingHand, PushingHand, SimulatedHand
from workers.simulation.lift_reference import LiftReference, NodeForcesRecorder
from workers.simulation.lifter import SuctionLifter
from workers.simulation.recording import LIFT_UNITS, MOTION_EVERY, Failure, Recorder
from workers.simulation.settings import SimulationSettings, WinchSettings
from workers.simulation.timeline import PlannedMoment
from workers.simulation.world import LiftWorld

_REPORT_EVERY = 50
"""Steps between two reports of progress."""
LiftFailure = Failure[LiftEnding]


class LiftExecution:
    """One simulated run of a plan. Call `run` once."""

    def __init__(
        self,
        plan: Plan,
        scene: PlateLiftScene,
        world: LiftWorld,
        settings: SimulationSettings,
        rng: np.random.Generator,
        known: PlateLiftScene,
    ) -> None:
        """Prepare hands, cup and what the plan wants.

        Args:
            plan: solved.
            scene: as everything really is.
            world: the physics, at the start.
            settings: see there.
            rng: sensor noise, the lifter's force error, and the winch.
            known: the scene that it was planned in, and that the lift is prepared for.
        """
        self.scene, self.world, self.settings, self._rng = scene, world, settings, rng
        self._known = known
        self.reference = LiftReference(plan, scene.cup.T_plate_cup[:3, 3])
        friction = scene.friction
        grip_arm, push_arm = scene.cell.gripper_arms[0], scene.cell.pusher_arms[0]
        first = {name: 6 * i for i, name in enumerate(scene.cell.arms)}
        arms = scene.cell.arms
        self.gripping = GrippingHand(
            arms[grip_arm], first[grip_arm], settings, rng, (friction.grip, friction.eps), scene.plate.height
        )
        self.pushing = PushingHand(
            arms[push_arm], first[push_arm], settings, rng, friction.push, scene.plate.com,
            self.reference.largest_pushes(push_arm),
        )  # fmt: skip
        self.hands: tuple[SimulatedHand, ...] = (self.gripping, self.pushing)
        self._arms = [first[grip_arm] // 6, first[push_arm] // 6]
        """Of each hand, in the order of the cell's."""
        self._T_flange_hands = np.empty((len(arms), 4, 4))
        self._T_flange_hands[self._arms] = [hand.T_flange_hand for hand in self.hands]
        self.lifter = SuctionLifter(scene, settings.cup, settings.contact, rng)
        self.recorder = Recorder(LIFT_UNITS, length_digits=5)
        self.comparison = NodeForcesRecorder(self.reference, settings.step)
        self.motion: list[tuple[float, Array, Transform]] = []
        """Time, joint positions and plate pose, at some of the recorder's times."""
        self.largest_way_off = 0.0, 0.0
        """Of the plate during the manipulation: distance of the cup's place [m] and angle [rad]."""
        self.lift: CooperativeLift | None = None
        self.time = 0.0
        self._watch = _Watch(self.lifter, self.gripping, self.pushing, scene.hand_force_limit.net, settings)
        self._last = self.reference.at(self.reference.duration)
        self._place0, self._R0 = np.zeros(3), np.eye(3)
        self._tick = round(settings.sensor.period / settings.step)
        self._record = round(settings.record_period / settings.step)
        self._steps = 0
        self._corrections = np.zeros(12)

    def run(self, progress: Progress) -> LiftFailure | None:
        """Execute everything; return what gave way, None when the plate was lifted."""

        def report() -> None:
            if self._steps % _REPORT_EVERY == 0:
                progress(Report("simulate", round(1000.0 * self._part_done()), 1000))

        failure = self._manipulate(report) or self._settle(report) or self._follow(report)
        if failure is None:
            progress(Report("simulate", 1, 1))
        return failure

    def prepare(self) -> LiftFailure | None:
        """Execute everything until the lifter begins to rise; return what gave way, None when the plate hangs still."""
        return self._manipulate(_untold) or self._settle(_untold)

    def lift_behind(self, winch: WinchSettings, seed: int) -> LiftFailure | None:
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

    def _manipulate(self, report: Callable[[], None]) -> LiftFailure | None:
        moments = self.reference.every(self.settings.step)
        moment, end = next(moments), self.reference.duration - 0.5 * self.settings.step
        while self.time < end:
            ahead = next(moments)
            failure = self._manipulate_step(moment, ahead, self.reference.wrench)
            if failure is not None:
                return failure
            if self.comparison.due(self.time, moment):
                self.comparison.take(self.time, moment, self._forces())
            report()
            moment = ahead
        return None

    def _settle(self, report: Callable[[], None]) -> LiftFailure | None:
        """Let the hands take on the goal forces of the lift while the plate hangs still, and prepare the lift."""
        reference, moment = self.reference, self._last
        com = self.scene.plate.com
        forces = LiftForces.find(self._known, reference.plate_rotation(moment), self.gripping, self.pushing, com)
        if forces is None:
            return Failure("overload", self.time, "hands and cup cannot bear the plate in the air")
        begin, seconds = self.time, self.settings.settle
        first = {name: reference.wrench(name, moment) for name in forces.wrenches}
        while self.time < begin + seconds - 0.5 * self.settings.step:
            part = min(1.0, 2.0 * (self.time - begin) / seconds)
            failure = self._manipulate_step(moment, moment, partial(_blend, first, forces.wrenches, part))
            if failure is not None:
                return failure
            report()
        self._prepare_lift(forces)
        return None

    def _manipulate_step(
        self, moment: PlannedMoment, ahead: PlannedMoment, wanted: Callable[[str, PlannedMoment], Array | None]
    ) -> LiftFailure | None:
        """Take one step along the plan.

        Args:
            moment: where it begins.
            ahead: where it ends.
            wanted: returns the wrench (6,) that an arm or "cup" is told to exert at its begin.
        """
        plate, reference = self.world.plate.motion, self.reference
        positions, velocities = ahead.positions, ahead.velocities
        if self._steps % self._tick == 0:
            for hand in self.hands:
                hand.track(wanted(hand.arm.name, moment), reference.plate_rotation(moment))
                self._corrections[hand.joints] = hand.correction(positions[hand.joints])
                hand.sense(plate[:3], self.world.knock(hand.arm.name))
        cup = wanted("cup", moment)
        assert cup is not None
        point, velocity = reference.cup_point(moment), reference.cup_velocity(moment)
        wrench = self.lifter.give(cup, point, velocity, plate, self.settings.step)
        failure = self._step(positions + self._corrections, velocities, wrench, moment)
        if self._steps % self._record == 0:
            self._record_row(0.0, 0.0, 0.0)
            self._note_way_off(moment)
        return failure

    def _prepare_lift(self, forces: LiftForces) -> None:
        """Hang the plate on the winch as everything is now."""
        arms = (self.gripping.arm.name, self.pushing.arm.name)
        path = way_up(self.scene, self._last.positions, self._corrections, self.reference.T_world_plate[-1], arms)
        self.lift = CooperativeLift(self._known, forces, path, self.time, self.settings, self._rng)
        plate = self.world.plate.motion
        self.lifter.hang(plate, forces.wrenches["cup"][3:])
        self._place0, self._R0 = self.lifter.place(plate), plate[:3]

    def _follow(self, report: Callable[[], None]) -> LiftFailure | None:
        """Let the winch go up, and the hands after it."""
        lift = self.lift
        assert lift is not None
        while self.time < lift.end:
            if self._steps % self._tick == 0:
                # The law gets the reading before: it takes one period from the sensor to the arms.
                lift.command(sum(float(hand.reading[2]) for hand in self.hands))
                rotation = self.world.plate.motion[:3]
                for hand in self.hands:
                    hand.sense(rotation, self.world.knock(hand.arm.name))
            height, speed = lift.lifter(self.time)
            wrench = self.lifter.hoist(height, speed, self.world.plate.motion)
            failure = self._step(*lift.advance(self.settings.step), wrench, self._last)
            if failure is not None:
                return failure
            if self._steps % self._record == 0:
                self._record_row(lift.velocity, speed, height)
            report()
        return None

    def _step(
        self, positions: Array, velocities: Array, cup_wrench: Array, moment: PlannedMoment
    ) -> LiftFailure | None:
        """Let hands and cup act for one step, drive the joints, and look for what gave way."""
        world = self.world
        plate = world.plate.motion
        total = cup_wrench.copy()
        T_world_hands, twists = world.hands(self._T_flange_hands)
        for hand, arm in zip(self.hands, self._arms, strict=True):
            hand.update(moment, T_world_hands[arm], plate)
            if hand.touch.engaged:
                wrench = hand.touch.act(T_world_hands[arm], twists[arm], plate)
                world.push_hand(hand.arm.name, -wrench, plate[3])
                total += wrench
        world.plate.push(total, plate[3])
        world.drive(positions, velocities)
        world.advance()
        self.time += self.settings.step
        self._steps += 1
        wanted = self.reference.plate_rotation(moment) if self.lift is None else self._R0
        return self._watch.look(moment.segment, self.time, (wanted, world.plate.motion[:3]))

    def _forces(self) -> dict[str, Array]:
        """Return the force (3,) on the plate of everything that touches it, by who exerts it [N]."""
        hands = {hand.arm.name: hand.force for hand in self.hands}
        return hands | {"cup": self.lifter.force, "support": self.world.resting_force()}

    def _note_way_off(self, moment: PlannedMoment) -> None:
        plate = self.world.plate.motion
        way = self.lifter.place(plate) - self.reference.cup_point(moment)
        turned = rotation_angle(self.reference.plate_rotation(moment), plate[:3])
        far, askew = self.largest_way_off
        self.largest_way_off = max(far, math.hypot(*way.tolist())), max(askew, turned)

    def _record_row(self, velocity: float, lifter_velocity: float, lifter_height: float) -> None:
        plate = self.world.plate.motion
        push, grip = float(self.pushing.force[2]), float(self.gripping.force[2])
        height = 0.0 if self.lift is None else float(self.lifter.place(plate)[2] - self._place0[2])
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
            plate_tilt=math.degrees(math.acos(min(1.0, max(-1.0, plate[2, 2])))),
        )
        if len(self.recorder.time) % MOTION_EVERY == 1:
            self.motion.append((self.time, self.world.positions.copy(), self.world.plate.T_world_body))


class _Watch:
    """Looks at cup, hands and plate after every step: the first that gives way ends the run."""

    def __init__(
        self,
        lifter: SuctionLifter,
        gripping: GrippingHand,
        pushing: PushingHand,
        hand_limit: float,
        settings: SimulationSettings,
    ) -> None:
        """Watch the cup and two hands whose net force may be `hand_limit` [N]."""
        self._lifter, self._gripping, self._pushing = lifter, gripping, pushing
        self._step, self._settings = settings.step, settings.hand
        self._limit = settings.hand.overload * hand_limit
        self._least_cosine = math.cos(settings.hand.largest_turn)
        self._overloaded = 0.0
        self._segment: Segment | None = None
        self._held = False, False
        """Whether each hand should hold the plate in this segment."""

    def look(self, segment: Segment, time: float, turn: tuple[Array, Array]) -> LiftFailure | None:
        """Return what gave way in the last step, None if nothing did.

        Args:
            segment: of the plan.
            time: [s].
            turn: how the plate (3, 3) should be turned, and how it is.
        """
        cause = self._lifter.lets_go(self._step)
        if cause is not None:
            return Failure("cup_lost", time, cause)
        cause = self._slip(segment) or self._turned(turn)
        if cause is not None:
            return Failure("slipped", time, cause)
        cause = self._overload()
        if cause is not None:
            return Failure("overload", time, cause)
        return None

    def _slip(self, segment: Segment) -> str | None:
        if segment is not self._segment:
            keeps = segment.kind not in (SegmentKind.GRIP, SegmentKind.RELEASE)
            self._segment, self._held = segment, (keeps and bool(segment.grips), keeps and segment.push is not None)
        grips, pushes = self._held
        return self._gripping.lost(grips, self._step) or self._pushing.lost(pushes, self._step)

    def _turned(self, turn: tuple[Array, Array]) -> str | None:
        # The trace of the rotation between them is one and twice the cosine of its angle.
        if 0.5 * (float(np.vdot(*turn)) - 1.0) >= self._least_cosine:
            return None
        return f"the plate turned by {np.degrees(rotation_angle(*turn)):.0f} degrees from where it should be"

    def _overload(self) -> str | None:
        gripped, pushed = math.hypot(*self._gripping.force.tolist()), math.hypot(*self._pushing.force.tolist())
        most, hand = (gripped, self._gripping) if gripped >= pushed else (pushed, self._pushing)
        self._overloaded = self._overloaded + self._step if most > self._limit else 0.0
        if self._overloaded <= self._settings.overload_time:
            return None
        seconds = self._settings.overload_time
        return f"the {hand.arm.name} hand bore {most:.1f} N, more than {self._limit:.1f} N, for {seconds:g} s"


def _untold() -> None:
    """Tell nobody how far it is."""


def _blend(
    firsts: Mapping[str, Array | None], lasts: Mapping[str, Array], part: float, name: str, _: PlannedMoment
) -> Array:
    """Return what lies between two wrenches of a name; a hand that bore nothing begins with nothing."""
    first, last = firsts[name], lasts[name]
    return part * last if first is None else (1.0 - part) * first + part * last
