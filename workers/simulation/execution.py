"""One run: the whole manipulation first, then the cooperative lift, until it is done or something gives way."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from enum import Enum
from typing import Any

import numpy as np

from planners.balance.contacts import GripContacts, PushContact
from planners.collision.placement import Attached
from planners.geometry.pose import Array, inverse, rotation_angle
from planners.kinematics.forward import flange_pose
from planners.lifting.leader_follower import FollowerGains, FollowerMotion, LeaderFollower
from planners.lifting.lift_goal import LiftGoal, lift_goal
from planners.lifting.lift_path import LiftPath, LiftPathSettings, lift_path
from planners.manipulation.workcell import LiftWorkcell
from planners.progress import Progress
from planners.scene.scene import PlateLiftScene
from workers.simulation.hands import GrippingHand, PushingHand, SimulatedHand
from workers.simulation.lifter import SuctionLifter
from workers.simulation.recorder import NodeForces, Recorder
from workers.simulation.reference import LEAD, Moment, PlanReference, Stage
from workers.simulation.settings import SimulationSettings
from workers.simulation.winch import WinchProfile
from workers.simulation.world import World

_MEAN_TIME = 0.06
"""Forces at a node are means over so long [s]."""


class SimulationOutcome(Enum):
    """How a simulated lift ended; the value is its name in the plan document."""

    LIFTED = "lifted"
    SLIPPED = "slipped"
    CUP_LOST = "cup_lost"
    OVERLOAD = "overload"


@dataclass(frozen=True)
class Failure:
    """What gave way."""

    outcome: SimulationOutcome
    time: float
    cause: str


@dataclass(frozen=True, eq=False)
class Lift:
    """The cooperative lift as it was prepared."""

    begin: float
    """[s]"""
    goal: LiftGoal
    path: LiftPath
    winch: WinchProfile


class Execution:
    """One simulated run of a plan. Call `run` once."""

    def __init__(
        self,
        document: Mapping[str, Any],
        scene: PlateLiftScene,
        world: World,
        settings: SimulationSettings,
        rng: np.random.Generator,
    ) -> None:
        """Prepare hands, cup and what the plan wants.

        Args:
            document: solved.
            scene: that it was planned in.
            world: the physics, at the start.
            settings: see there.
            rng: sensor noise, the lifter's force error, and the winch.
        """
        self.scene, self.world, self.settings, self._rng = scene, world, settings, rng
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
        self.nodes: list[NodeForces] = []
        self.motion: list[tuple[float, Array, Array]] = []
        """Time, joint positions and plate pose, at the recorder's times."""
        self.largest_way_off = np.zeros(2)
        """Of the plate during the manipulation: distance of the cup's place [m] and angle [rad]."""
        self.lift: Lift | None = None
        self.goal_push = 0.0
        """F_goal of eq. (11): vertical force of the pushing hand [N]."""
        self._place0, self._R0 = np.zeros(3), np.eye(3)
        self.time = 0.0
        self._tick = round(settings.sensor.period / settings.step)
        self._record = round(settings.record_period / settings.step)
        self._steps = 0
        self._corrections = np.zeros(12)
        self._recent: deque[dict[str, Array]] = deque(maxlen=max(1, round(_MEAN_TIME / settings.step)))
        self._over_load = 0.0

    def run(self, progress: Progress) -> Failure | None:
        """Execute everything; return what gave way, None when the plate was lifted."""
        total = self.reference.duration + self.settings.settle + 8.0

        def report() -> None:
            progress("simulate", round(100.0 * min(self.time, total)), round(100.0 * total))

        failure = self._manipulate(report) or self._settle(report)
        if failure is None:
            failure = self._lift(report)
        progress("simulate", 1, 1)
        return failure

    def _manipulate(self, report: Callable[[], None]) -> Failure | None:
        reference, step = self.reference, self.settings.step
        while self.time < reference.duration - 0.5 * step:
            moment = reference.at(self.time)
            failure = self._manipulate_step(moment)
            if failure is not None:
                return failure
            self._note_node(moment)
            if self._steps % 50 == 0:
                report()
        return None

    def _manipulate_step(self, moment: Moment, goal: Mapping[str, Array] | None = None) -> Failure | None:
        """Take one step along the plan; `goal` replaces the planned wrenches (6,) of hands and cup."""
        world, step = self.world, self.settings.step
        plate, stage = world.plate_motion(), moment.stage
        wanted = {name: moment.wrench(name) for name in ("left", "right", "cup")} if goal is None else goal
        ahead = self.reference.at(self.time + step)
        if self._steps % self._tick == 0:
            for hand in self.hands:
                hand.track(wanted[hand.arm.name], moment.rotation_world_plate)
                self._corrections[hand.joints] = hand.correction(ahead.positions[hand.joints])
                hand.sense()
        cup = wanted["cup"]
        assert cup is not None
        wrench = self.lifter.give(cup, moment.cup_point, moment.cup_velocity, plate, step)
        failure = self._step(ahead.positions + self._corrections, ahead.velocities, wrench, stage)
        if self._steps % self._record == 0:
            self._record_row(0.0, 0.0, 0.0)
            self._note_way_off(moment)
        return failure

    def _settle(self, report: Callable[[], None]) -> Failure | None:
        """Let the hands take on the goal forces of the lift while the plate hangs still."""
        moment = self.reference.at(self.reference.duration)
        goal, contacts = self._goal(moment)
        if goal is None:
            return Failure(SimulationOutcome.OVERLOAD, self.time, "hands and cup cannot bear the plate in the air")
        end = self.time + self.settings.settle
        first = {name: moment.wrench(name) for name in contacts}
        begin = self.time
        while self.time < end - 0.5 * self.settings.step:
            part = min(1.0, 2.0 * (self.time - begin) / self.settings.settle)
            blend = {name: (1.0 - part) * first[name] + part * wrench for name, wrench in contacts.items()}  # pyright: ignore
            failure = self._manipulate_step(moment, blend)
            if failure is not None:
                return failure
            if self._steps % 50 == 0:
                report()
        return self._prepare_lift(goal, moment, contacts["cup"])

    def _prepare_lift(self, goal: LiftGoal, moment: Moment, cup: Array) -> Failure | None:
        scene, gripper = self.scene, self.gripping.arm
        start = moment.positions
        workcell = LiftWorkcell(scene, gripper.name, self.pushing.arm.name)
        T_world_flange = flange_pose(gripper.dh, gripper.T_world_base, start[self.gripping.joints].copy())
        carried = Attached(gripper.name, inverse(T_world_flange) @ moment.reference.T_world_plate[moment.low])
        arms = {gripper.name, self.pushing.arm.name}
        query = workcell.query(
            workcell.holding,
            lambda a, b: bool({a.group, b.group} & arms) or workcell.lifted(a, b),
            carried,
            hands=tuple(arms),
        )
        planned = lift_path(scene.cell.arms, start, query)
        # The hands start from where their force control has put them, some millimetres off the plan.
        reach = LiftPathSettings(largest_height=planned.height)
        path = replace(lift_path(scene.cell.arms, start + self._corrections, None, reach), end=planned.end)
        travel = max(0.0, path.height - self.settings.headroom)
        winch = WinchProfile.draw(travel, self.settings.step, self._rng, self.settings.winch)
        self.lift = Lift(self.time, goal, path, winch)
        self.lifter.hang(self.world.plate_motion(), cup[3:])
        self._place0 = self.lifter.place(self.world.plate_motion())[0]
        self._R0 = self.world.plate_motion()[0]
        return None

    def _lift(self, report: Callable[[], None]) -> Failure | None:
        """Follow the winch: eq. (11) on the pushing hand's vertical force, the same velocity for both hands."""
        lift, s, world = self.lift, self.settings, self.world
        assert lift is not None
        gains = s.follower or FollowerGains.for_plate(self.scene.plate.mass or 1.0)
        law, motion = LeaderFollower(gains), FollowerMotion()
        fastest = 0.8 * lift.path.largest_speed(np.concatenate([a.velocity_max for a in self.scene.cell.arms.values()]))
        goal = self.goal_push
        height, stage = 0.0, self.reference.stages[-1]
        end = lift.begin + lift.winch.duration + s.rest
        while self.time < end:
            if self._steps % self._tick == 0:
                reading = float(self.pushing.reading[2])
                for hand in self.hands:
                    hand.sense()
                if s.controlled:
                    motion = law.follow(motion, goal, reading)
                    velocity = min(motion.velocity, fastest)
                else:
                    velocity = lift.winch.mean_speed if height < lift.winch.heights[-1] else 0.0
                motion = FollowerMotion(velocity, motion.lead)
            if height >= lift.path.height:
                motion = FollowerMotion(0.0, motion.lead)
            height += motion.velocity * s.step
            lifter_height, lifter_speed = lift.winch.at(self.time - lift.begin)
            wrench = self.lifter.hoist(lifter_height, lifter_speed, world.plate_motion())
            ahead = lift.path.at(height)
            velocities = (lift.path.at(height + 1e-3) - ahead) * (motion.velocity / 1e-3)
            failure = self._step(ahead, velocities, wrench, stage)
            if failure is not None:
                return failure
            if self._steps % self._record == 0:
                self._record_row(motion.velocity, lifter_speed, lifter_height)
            if self._steps % 50 == 0:
                report()
        return None

    def _step(self, positions: Array, velocities: Array, cup_wrench: Array, stage: Stage) -> Failure | None:
        """Let hands and cup act for one step, drive the joints, and look for what gave way."""
        world, step = self.world, self.settings.step
        plate = world.plate_motion()
        total = cup_wrench.copy()
        for hand in self.hands:
            T_world_hand, twist = world.hand(hand.arm.name, hand.T_flange_hand)
            hand.update(stage, self.time, T_world_hand, plate)  # pyright: ignore
            total += hand.touch.act(T_world_hand, twist, plate)
            if hand.pressed:
                for force, place in zip(hand.touch.forces, hand.touch.places, strict=True):
                    world.push_hand(hand.arm.name, -force, place)
        world.push_plate(total)
        world.drive(positions, velocities)
        world.advance()
        self.time += step
        self._steps += 1
        return self._what_gave_way(stage)

    def _what_gave_way(self, stage: Stage) -> Failure | None:
        step, s = self.settings.step, self.settings.hand
        cause = self.lifter.lets_go(step)
        if cause is not None:
            return Failure(SimulationOutcome.CUP_LOST, self.time, cause)
        for hand, expected in ((self.gripping, stage.grip is not None), (self.pushing, stage.push is not None)):
            cause = hand.lost(expected and stage.kind not in ("grip", "release"), step)
            if cause is not None:
                return Failure(SimulationOutcome.SLIPPED, self.time, cause)
        net = {hand.arm.name: float(np.linalg.norm(hand.force)) for hand in self.hands}
        limit = s.overload * self.scene.hand_force_limit.net
        self._over_load = self._over_load + step if max(net.values()) > limit else 0.0
        if self._over_load > s.overload_time:
            worst = max(net, key=lambda name: net[name])
            cause = f"the {worst} hand bore {net[worst]:.1f} N, more than {limit:.1f} N, for {s.overload_time:g} s"
            return Failure(SimulationOutcome.OVERLOAD, self.time, cause)
        if self.lift is not None:
            turned = rotation_angle(self._R0, self.world.plate_motion()[0])
            if turned > s.largest_turn:
                cause = f"the plate turned by {np.degrees(turned):.0f} degrees in the hands"
                return Failure(SimulationOutcome.SLIPPED, self.time, cause)
        return None

    def _goal(self, moment: Moment) -> tuple[LiftGoal | None, dict[str, Array]]:
        """Return the goal of the lift and the (6,) wrenches of hands and cup in it."""
        T = moment.reference.T_world_plate[moment.low]
        R = T[:3, :3]
        grip_arm, push_arm = self.gripping.arm.name, self.pushing.arm.name
        anchors, com = self.gripping.touch.anchors, self.scene.plate.com
        points = np.array([anchors[:4].mean(axis=0), anchors[4:].mean(axis=0)]) + com
        grip = GripContacts(points, self.gripping.touch.normals[[0, 4]])
        push = PushContact(self.pushing.touch.anchors[0] + com, self.pushing.touch.normals[0])
        goal = lift_goal(self.scene, R, grip, push)
        if goal is None:
            return None, {}
        wrenches = dict(zip(goal.balance.contacts, goal.balance.wrenches_world, strict=True))
        fingers = [wrenches["grip_0"], wrenches["grip_1"]]
        total = fingers[0] + fingers[1]
        middle = points.mean(axis=0)
        for point, wrench in zip(points, fingers, strict=True):
            total[3:] += np.cross(R @ (point - middle), wrench[:3])
        self.goal_push = float(wrenches["push"][2])
        return goal, {grip_arm: total, push_arm: wrenches["push"], "cup": wrenches["cup"]}

    def _note_node(self, moment: Moment) -> None:
        """Compare forces at the end of a motion of the plate, before the lifter prepares for what comes next."""
        stage, step = moment.stage, self.settings.step
        last = stage is self.reference.stages[-1]
        due = stage.end - (0.0 if last else min(LEAD, 0.5 * (stage.end - stage.begin)))
        if stage.kind != "transfer" or not due - _MEAN_TIME < self.time <= due + step:
            return
        forces = {hand.arm.name: hand.force for hand in self.hands}
        self._recent.append(forces | {"cup": self.lifter.force, "support": self.world.resting_force()})
        if self.time + step <= due:
            return
        planned = moment.planned_forces()
        simulated = {name: np.mean([row[name] for row in self._recent], axis=0) for name in planned}
        number = self.reference.stages.index(stage)
        if not self.nodes or self.nodes[-1].segment != number:
            self.nodes.append(NodeForces(number, self.time, planned, simulated))
        self._recent.clear()

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
