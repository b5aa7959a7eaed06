"""Budgets, distances and paces of a suction-tool plan."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

from planners.cell.cell import Cell
from planners.cell.cell_size import resized
from planners.geometry.pose import Transform
from planners.motion.query import MotionSettings
from planners.motion.timing import TimingSettings
from planners.regrasp.grasps.handovers import HandoverSettings
from planners.regrasp.grasps.tool_grasps import Fingertips
from planners.regrasp.statics.laden_arm import TorqueSettings
from planners.regrasp.suction.suction_poses import SuctionSettings
from planners.regrasp.tool_workcell import ToolClearance

LYING = math.radians(45.0)
"""A tool whose axis is farther from the vertical lies [rad]."""


@dataclass(frozen=True)
class CarrySettings:
    """Straight ways of the tool and of what it carries. Distances are those of the paper where it names them."""

    unrest: float = 0.080
    """Straight up with the tool off its rest [m]."""
    out_of_socket: float = 0.030
    """Straight up beyond the walls of the cell's rest, at least [m]."""
    descent: float = 0.050
    """Along the normal of the facet, onto the object and off it [m]."""
    lift: float = 0.050
    """Straight up with the object, and straight down to its goal [m]."""
    approach: float = 0.070
    """Of a hand along its own z, to the tool and off it (the authors') [m]."""
    layer_step: float = 0.0125
    """Between the places of a straight way at which a grasp of a layer is looked at [m]."""
    step: float = 0.005
    """Between the places of a straight way that is followed [m]."""
    continuity: float = 0.25
    """Largest joint step between those that still counts as continuous [rad]."""
    level: float = math.radians(75.0)
    """A tool with an object that is tilted by more is reached and left in a turn about the object's centre of mass
    [rad]; as for handovers."""
    reliefs: tuple[float, ...] = (math.radians(68.0), math.radians(80.0))
    """Tilts from which such turns begin, or at which they end; the next where one is not possible [rad]."""

    def off_rest(self, cell: Cell) -> float:
        """Return how far the tool is taken straight up off its rest, which may be the cell's socket [m]."""
        deep = 0.0 if cell.tool_rest is None else cell.tool_rest.depth
        return max(self.unrest, deep + self.out_of_socket)


@dataclass(frozen=True)
class ToolPace:
    """How fast hands go where they are next to something, and how long fingers and vacuum take."""

    straight_speed: float = 0.15
    """Of hand or tool on a straight way [m/s]."""
    straight_acceleration: float = 0.5
    """[m/s^2]"""
    carried_speed: float = 0.10
    """The same with an object on the cup [m/s]."""
    carried_acceleration: float = 0.3
    """[m/s^2]"""
    finger_time: float = 0.4
    """Fingers close or open [s]."""
    vacuum_time: float = 0.5
    """The vacuum builds up, or the object comes off the cup [s]."""
    handover_time: float = 0.2
    """Both hands hold the tool before the giver lets go [s]."""


@dataclass(frozen=True)
class CarriedPace:
    """How fast bodies in a hand move through free space; their contact forces are shown at samples of a plan only."""

    speed: float = 0.9
    """Of any centre of mass [m/s]: 10 mm between two samples, less a reserve."""
    turn: float = 3.2
    """Of any body [rad/s]: 2 degrees between two samples, less a reserve."""
    sample_step: float = 0.01
    """Longest time between samples [s]: half of what the plan document asks for, so that hands need not be slow."""


@dataclass(frozen=True)
class StopoverSettings:
    """Which places are looked at, and in which poses. All of it is our choice."""

    spacing: float = 0.05
    """Of the places on a level face [m]."""
    turns: int = 2
    """Turns about the vertical of an object that stays as upright as it stands, evenly around half a turn."""
    clearances: tuple[float, ...] = (0.06, 0.02)
    """Room on all sides to everything that stands or is to stand there [m]; the next where there are no places with
    the one before."""
    most: int = 8
    """Places offered as goals, the nearest."""
    turns_on_others: int = 4
    """Turns about the vertical of an object that rests on another face, evenly around: the tool is level then, and
    where it points decides whether a hand reaches it."""
    most_on_others: int = 32
    """Poses offered as goals where it rests on another face."""
    faces: int = 6
    """Faces on which an object is put down at all, the steadiest; the one on which it rests comes first."""
    steady: float = math.radians(10.0)
    """Least tilt at which an object topples over an edge of the face it is put down on [rad]."""


@dataclass(frozen=True)
class ToolPlannerSettings:
    """Budgets and choices of a suction-tool plan. Budgets count tries, never seconds."""

    suction: SuctionSettings = field(default_factory=SuctionSettings)
    handovers: HandoverSettings = field(default_factory=HandoverSettings)
    carry: CarrySettings = field(default_factory=CarrySettings)
    pace: ToolPace = field(default_factory=ToolPace)
    carried: CarriedPace = field(default_factory=CarriedPace)
    motion: MotionSettings = field(
        default_factory=lambda: MotionSettings(max_iterations=500, searches=3, near_share=1.5)
    )
    timing: TimingSettings = field(default_factory=TimingSettings)
    stopover: StopoverSettings = field(default_factory=StopoverSettings)
    fingertips: Fingertips = field(default_factory=Fingertips)
    """How a tool that lies is held too."""
    most_handovers: int = 2
    """In each of the two rounds."""
    suction_group: int = 8
    """Suction poses that are asked together for the route with the fewest handovers: the rolls of one place."""
    detour: float = 0.3
    """A branch may make the way to the next pose of the tool so much longer than the shortest does [s]."""
    near_goals: int = 6
    """Goals of one object that are asked first, those that turn the tool least; the rest only for direct routes."""
    suction_poses: int = 40
    """Suction poses of an object that are tried at all."""
    sequences: int = 8
    """Sequences of one suction pose whose motion is tried before the next suction pose."""
    slow_motion: float = 10.8
    """Where the longest motion of a sequence takes longer than a way of so many times what the shorter arm reaches, at
    the pace of what is carried, others are tried too [1]."""
    second_thoughts: int = 3
    """Slow sequences of one object that are put back while others are tried; the shortest of all is moved."""
    group_tries: int = 16
    """Sequences of one group of suction poses whose motion is tried before the next group."""
    tries: int = 40
    """Sequences of one move whose motion is tried, over all suction poses. A task has as many for each of its objects,
    and for one move more, over all orders and stopovers: plans that are found need few, and a "no" should not take a
    minute."""
    orientations: int = 6
    """Handover orientations of one pair of grasps whose motion is tried."""
    orders: int = 8
    """Moves that are planned because another order is tried or an object makes a stopover, beyond one an object."""
    carried_tilt: float = math.radians(40.0)
    """Most tilt of the tool while an object hangs on it, unless an end of the motion is tilted more [rad]."""
    handover_tilt: float = math.radians(75.0)
    """Most tilt of the tool at a handover while an object hangs on it [rad]: a level cup bears no push at all."""
    finger_reserve: float = 0.1
    """Part of the fingers' friction that is left at rest, for what inertia adds; motion is slowed for the rest."""
    torque: TorqueSettings = field(default_factory=TorqueSettings)
    reserve_searches: int = 3
    """Searches between the reserve of a plan without one asked for, and the one asked for with which none was found."""
    handover_seconds: float = 8.0
    """Cost of ending with a grasp in which the next object cannot be moved without a handover [s]: what one takes."""
    partner_weight: float = 0.5
    """Cost of such a grasp that has no handover partner against one that has the most [s]."""
    onward_goals: int = 3
    """Goals of the next object that are looked at for each suction pose."""

    def with_fingertips(self) -> ToolPlannerSettings:
        """Return the settings for a tool that lies: hands may hold it by their fingertips too."""
        grasps = replace(self.handovers.grasps, fingertips=self.fingertips)
        return replace(self, handovers=replace(self.handovers, grasps=grasps))

    def in_cell(self, cell: Cell) -> ToolPlannerSettings:
        """Return the settings with a cell's collision margins, and with the lengths and paces of its size.

        Here they are those of size 1. With ways s times as long, speeds are √s times as large, come to with the same
        acceleration, and times √s times as long; so turns take that, too, and samples are as far apart as they were.
        """
        size, root, clearance = cell.size, math.sqrt(cell.size), ToolClearance.of(cell)
        grasps = self.handovers.grasps.in_cell(size, clearance)
        carry = resized(self.carry, size, "unrest", "out_of_socket", "descent", "lift", "approach")
        seconds = resized(self, root, "detour", "handover_seconds", "partner_weight")
        return replace(
            seconds,
            suction=resized(self.suction, size, "border", "rim", "stand_off", "spacing", "finest", "cluster"),
            handovers=replace(self.handovers, grasps=grasps, clearance=resized(clearance, size, "width_step")),
            fingertips=resized(self.fingertips, size, "least", "most", "most_off_centre"),
            carry=resized(carry, clearance.steps, "layer_step", "step"),
            pace=resized(self.pace, root, "straight_speed", "carried_speed"),
            carried=resized(resized(self.carried, root, "speed"), 1.0 / root, "turn", "sample_step"),
            stopover=resized(self.stopover, size, "spacing", "clearances"),
        )

    def hasty(self) -> ToolPlannerSettings:
        """Return the settings of somebody who gives up early; what they find is found with these too."""
        return replace(self, stopover=replace(self.stopover, faces=0), orders=0, suction_poses=16, tries=10)

    def starting_at(self, T_world_tool: Transform) -> ToolPlannerSettings:
        """Return the settings for a tool that is at a pose (4, 4) at the start, standing or lying."""
        return self.with_fingertips() if abs(T_world_tool[2, 2]) < math.cos(LYING) else self
