"""What simulations assume beyond the task: engineering choices, where nothing is said."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Self

from planners.cell.cell_size import pad_stiffness, resized
from planners.cell.hand import Gripper, Pusher
from planners.lifting.hand_admittance import LEAST_PUSH, HandAdmittance
from planners.lifting.leader_follower import FollowerGains
from planners.scene.lift_scene import PlateLiftScene


@dataclass(frozen=True)
class ContactSettings:
    """Rubber on the plate."""

    friction_factor: float = 1.0
    """True friction over that of the task, of all contacts [1]: physics tests the plan, not rubber that is better."""
    squeeze: float = 60.0
    """Force of each of the gripper's fingers where the plan commands none [N]: internal, no load of the arm."""
    pad_normal_stiffness: float = 30e3
    """Of one pad with its finger [N/m]."""
    pad_tangential_stiffness: float = 40e3
    """[N/m]. A pad is four points at the soft finger's eccentricity of 7.5 mm, so that friction bears the planned
    torque and no more. Rubber of 15e3 N/m all over 22 x 37.5 mm resists turning as these four points do at 40e3."""
    tip_normal_stiffness: float = 20e3
    """Of the stick's rubber tip, of the papers' size and in pushes like theirs [N/m]; see `tip_stiffness`."""
    tip_tangential_stiffness: float = 10e3
    """[N/m]"""
    damping_time: float = 0.004
    """Damping over stiffness of all contacts [s]."""
    pad_aspect: float = 37.5 / 22.0
    """Length over width of a pad: a pad is four points at the soft finger's eccentricity [1]."""
    least_push: float = LEAST_PUSH
    """The stick never presses less while it is to push [N]."""

    @classmethod
    def of(cls, gripper: Gripper) -> Self:
        """Return the same rubber on pads of another size."""
        width, _, length = gripper.pad_size.tolist()
        shaped, stiffer = replace(cls(), pad_aspect=length / width), pad_stiffness(gripper.pad_size)
        return resized(shaped, stiffer, "pad_normal_stiffness", "pad_tangential_stiffness")


@dataclass(frozen=True)
class CupSettings:
    """The suction cup on its lifter."""

    travel: float = 0.02
    """Stretch of cup and suspension under the cup's largest force [m]: 1 N/mm for 20 N, 3 N/mm for 60 N."""
    damping_time: float = 0.02
    """Damping over stiffness [s]."""
    error: float = 0.03
    """Standard deviation of the force that the lifter gives during the manipulation, of the planned one [1]."""
    error_time: float = 1.0
    """How fast that error changes [s]."""
    saturation: float = 1.0
    """During the manipulation the lifter's force ends at this part of the cup's largest [1]."""
    strength: float = 1.0
    """Force that the cup really bears over the one that it is planned with [1]."""
    grace: float = 0.2
    """A cup lets go when it is over its limit for so long [s]."""
    burst: float = 1.3
    """Or at once above this multiple of its limit [1]."""

    def stiffness(self, max_force: float) -> float:
        """Return the stiffness of a cup with its suspension, by the cup's largest force [N/m]."""
        return max_force / self.travel


@dataclass(frozen=True)
class WinchSettings:
    """How somebody operates the lifter's switch: moves and holds, never the same speed, all drawn from the seed."""

    speed: tuple[float, float] = (0.02, 0.05)
    """Of one move [m/s]."""
    move: tuple[float, float] = (0.3, 1.5)
    """Duration of a move [s]."""
    hold: tuple[float, float] = (0.2, 0.8)
    """Duration of a hold [s]."""
    hold_chance: float = 0.5
    """That a move is followed by a hold instead of another speed [1]."""
    acceleration: float = 0.5
    """When the switch is pressed [m/s^2]."""
    deceleration: float = 0.5
    """When it is let go [m/s^2]."""
    jerk_chance: float = 0.3
    """That a move begins with a jerk [1]."""
    jerk_speed: float = 0.08
    """[m/s]"""
    jerk_time: float = 0.06
    """[s]"""

    def times(self, factor: float) -> Self:
        """Return a lifter that is so many times as fast; its motor pulls and brakes as hard as ever."""
        low, high = self.speed
        return replace(self, speed=(factor * low, factor * high), jerk_speed=factor * self.jerk_speed)

    @property
    def usual_speed(self) -> float:
        """Expected rise over expected time, holds included [m/s]: what is known of such lifters, not of one."""
        move, speed, hold = (0.5 * sum(ends) for ends in (self.move, self.speed, self.hold))
        jerk = self.jerk_chance * self.jerk_time
        return (move * speed + jerk * self.jerk_speed) / (move + jerk + self.hold_chance * hold)


@dataclass(frozen=True)
class SensorSettings:
    """FT300 [facts of its maker; noise an engineering choice]."""

    period: float = 0.01
    """[s]"""
    force_noise: float = 0.5
    """Standard deviation [N]."""
    force_bias: float = 5.0
    """Standard deviation of the offset before taring [N]."""
    torque_noise: float = 0.02
    """Standard deviation [Nm]."""
    torque_bias: float = 0.2
    """Standard deviation of the offset before taring [Nm]."""
    tare_readings: int = 50
    """Readings that are averaged when the hand bears nothing [1]."""


@dataclass(frozen=True)
class HandSettings(HandAdmittance):
    """How a hand tracks its planned wrench during the manipulation, and when it has failed."""

    servo_gain: float = 0.4
    """Part of a joint's position error that is made good in one period of the robot [1]."""
    largest_slip: float = 0.012
    """A hand that slid further on the plate has slipped [m]."""
    lost_time: float = 0.25
    """A hand that should hold and has not touched for so long has slipped [s]."""
    overload: float = 1.5
    """A hand's net force over its limit at which the robot stops, when held for `overload_time` [1]."""
    overload_time: float = 0.2
    """[s]"""
    largest_turn: float = math.radians(20.0)
    """A plate turned further from where it should be counts as slipped [rad]."""


@dataclass(frozen=True)
class SimulationSettings:
    """Everything of a plate lift, with the simulation's own step."""

    step: float = 0.002
    """Of physics and joint control [s]: UR3e, 500 Hz."""
    settle: float = 1.5
    """Between the manipulation and the lift, for the hands to take on the goal forces [s]."""
    rest: float = 1.0
    """After the lifter has stopped [s]."""
    headroom: float = 0.015
    """The lifter is stopped so far below the highest place that both arms reach [m]."""
    record_period: float = 0.02
    """Of the curves [s]."""
    controlled: bool = True
    """Whether the hands follow by force; otherwise they rise at `WinchSettings.usual_speed`, blind."""
    contact: ContactSettings = field(default_factory=ContactSettings)
    cup: CupSettings = field(default_factory=CupSettings)
    winch: WinchSettings = field(default_factory=WinchSettings)
    sensor: SensorSettings = field(default_factory=SensorSettings)
    hand: HandSettings = field(default_factory=HandSettings)
    follower: FollowerGains | None = None
    """None: those that fit the plate and the cup."""

    @classmethod
    def of(cls, scene: PlateLiftScene) -> Self:
        """Return settings for a scene's hands and the size of its cell; here they are those of the papers' cell.

        What belongs to sensors, servos and whoever operates the lifter stays, and so do the slips that are a failure.
        """
        cell, limit, arm = scene.cell, scene.hand_force_limit, scene.cell.pusher_arms[0]
        push = min(limit.normal, limit.net, cell.payload_force(arm))
        gripper, pusher = cell.gripper(cell.gripper_arms[0]), cell.arms[arm].hand
        assert isinstance(pusher, Pusher)
        return replace(
            resized(cls(), cell.size, "headroom"),
            contact=ContactSettings.of(gripper),
            cup=resized(CupSettings(), cell.size, "travel"),
            hand=HandSettings.of(pusher.tip_radius, push, scene.friction.eps),
        )


@dataclass(frozen=True)
class BondStiffness:
    """A hold's compliance."""

    linear: float
    """[N/m]"""
    angular: float
    """[Nm/rad]"""
    damping_time: float
    """Damping over stiffness [s]."""

    def of_other_rubber(self, stiffer: float, wider: float) -> BondStiffness:
        """Return that of rubber that is so many times as stiff and reaches so many times as far from its middle [1]."""
        return BondStiffness(stiffer * self.linear, stiffer * wider**2 * self.angular, self.damping_time)


PAD_LENGTH = 0.0375
"""Of the pads whose compliance is `FINGERS` [m]."""
FINGERS = BondStiffness(linear=100e3, angular=40.0, damping_time=0.004)
"""Two pads of rubber, 22 x 37.5 mm, with their fingers."""
LIP_RADIUS = 0.0175
"""Of the lip whose compliance is `CUP` [m]."""
CUP = BondStiffness(linear=20e3, angular=6.0, damping_time=0.004)
"""A flat lip of 35 mm."""


@dataclass(frozen=True)
class EnduranceSettings:
    """How long a hold bears more than its limit."""

    grace: float = 0.2
    """A hold lets go when it is over its limit for so long [s]."""
    burst: float = 1.3
    """Or at once above this multiple of its limit [1]."""


@dataclass(frozen=True)
class TruthSettings:
    """What is otherwise than the plan believes; all 1: nothing."""

    cup_strength: float = 1.0
    """What the cup bears of its stated limits [1]."""
    grip_strength: float = 1.0
    """With which fingers squeeze, of what the plan commands [1]."""
    grip_friction: float = 1.0
    """Of fingers on the tool over the planned [1]."""
    object_mass: float = 1.0
    """Mass of all objects over the stated [1]."""


@dataclass(frozen=True)
class TakingSettings:
    """How exactly fingers and cup must meet what they take."""

    finger_distance: float = 0.012
    """Of the tool from where it was planned to be between the pads [m]: half a pad's width."""
    finger_angle: float = math.radians(12.0)
    """[rad]"""
    cup_gap: float = 0.004
    """Between lip and object along the cup's axis [m]: what a lip of 35 mm makes up for."""
    cup_angle: float = math.radians(5.0)
    """Between the cup's axis and the planned one [rad]."""
    cup_offset: float = 0.010
    """Of the lip from its planned place on the object [m]."""


@dataclass(frozen=True)
class WatchSettings:
    """When something that should stand has not stood."""

    period: float = 0.01
    """Between two looks [s]."""
    fall: float = 0.006
    """What nothing holds has fallen when it is so much lower than where it was let go [m]."""
    tilt: float = math.radians(15.0)
    """Or toppled when it has turned so far [rad]."""
    shift: float = 0.015
    """Or been pushed when it is so far from there [m]."""
    goal_distance: float = 0.005
    """At the end an object is at its goal within this [m]."""
    goal_angle: float = math.radians(3.0)
    """[rad]"""


@dataclass(frozen=True)
class ToolSimulationSettings:
    """Everything of a suction-tool plan, with the simulation's own step."""

    step: float = 0.002
    """Of physics and joint control [s]: UR3e, 500 Hz."""
    servo_gain: float = 0.4
    """Part of a joint's position error that is made good in one period of the robot [1]."""
    settle: float = 0.6
    """After the plan's end, before the goals are compared [s]."""
    aftermath: float = 0.8
    """Shown after something gave way; the robot has stopped [s]."""
    record_period: float = 0.02
    """Of the curves [s]."""
    close_at: float = 0.6
    """Part of a grip after which the fingers hold the tool [1]."""
    open_at: float = 0.3
    """Part of a release after which they no longer do [1]."""
    vacuum_at: float = 0.5
    """Part of an attach or detach after which the vacuum is there, or gone [1]."""
    fingers: BondStiffness = FINGERS
    """Of the papers' pads; those of other hands follow from their size."""
    cup: BondStiffness = CUP
    """Of a lip of `LIP_RADIUS`; that of another tool follows from its own."""
    truth: TruthSettings = field(default_factory=TruthSettings)
    taking: TakingSettings = field(default_factory=TakingSettings)
    endurance: EnduranceSettings = field(default_factory=EnduranceSettings)
    watch: WatchSettings = field(default_factory=WatchSettings)
