"""What the simulation of a suction-tool plan assumes beyond the task. Engineering choices, where nothing is said."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from workers.simulation.bond import BondStiffness
from workers.simulation.endurance import EnduranceSettings

FINGERS = BondStiffness(linear=100e3, angular=40.0, damping_time=0.004)
"""Two pads of rubber, 22 x 37.5 mm, with their fingers."""
CUP = BondStiffness(linear=20e3, angular=6.0, damping_time=0.004)
"""A flat lip of 35 mm."""


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
    """Everything, with the simulation's own step."""

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
    cup: BondStiffness = CUP
    truth: TruthSettings = field(default_factory=TruthSettings)
    taking: TakingSettings = field(default_factory=TakingSettings)
    endurance: EnduranceSettings = field(default_factory=EnduranceSettings)
    watch: WatchSettings = field(default_factory=WatchSettings)
