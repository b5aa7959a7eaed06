"""The cooperative lift: the winch goes up as it likes, and both hands follow what they feel."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from planners.balance.contacts import GripContacts, PushContact
from planners.cell.cell_size import resized
from planners.collision.model import Attached
from planners.geometry.convex import CollisionBody
from planners.geometry.pose import Array, Transform, inverse
from planners.kinematics.forward import flange_pose
from planners.lifting.leader_follower import FollowerGains, FollowerMotion, LeaderFollower
from planners.lifting.lift_goal import LiftGoal, lift_goal
from planners.lifting.lift_loop import HungPlate, box_inertia, design_gains, felt_mass, moved_stiffness
from planners.lifting.lift_path import LiftPath, LiftPathSettings, lift_path
from planners.manipulation.reach.lift_workcell import PLATE_FRAME, LiftWorkcell
from planners.manipulation.statics.lift_programs import balance_program
from planners.scene.lift_scene import PlateLiftScene
from workers.simulation.hands import GrippingHand, PushingHand
from workers.simulation.lifter import WinchProfile
from workers.simulation.settings import SimulationSettings

_LIMIT_SHARE = 0.8
"""Part of the joints' speed limits that the follower uses [1]: force control corrects on top of it."""
_SLOPE_STEP = 1e-3
"""For the joints' slope over the height [m]."""


@dataclass(frozen=True, eq=False)
class LiftForces:
    """F_goal of eq. (11) for the hands as they have got hold of the plate."""

    goal: LiftGoal
    wrenches: Mapping[str, Array]
    """By arm and "cup": (6,) on the plate about the middle of the contacts, world axes [N, Nm]."""
    push: float
    """Vertical force of the pushing hand [N]."""
    both: float
    """Vertical force of both hands together [N]."""
    gains: FollowerGains
    """With which both hands follow."""

    @classmethod
    def find(
        cls, scene: PlateLiftScene, R_world_plate: Array, gripping: GrippingHand, pushing: PushingHand, com: Array
    ) -> Self | None:
        """Solve (5) for the plate hanging in this orientation; None: hands and cup cannot bear it.

        Args:
            scene: plate and cup as they are known.
            R_world_plate: how the plate hangs.
            gripping: as it has got hold of the plate.
            pushing: likewise.
            com: (3,) where the plate's centre of mass really is, from which the hands' contacts are told [m].
        """
        touch = gripping.touch
        pads = np.array([touch.anchors[:4].mean(axis=0), touch.anchors[4:].mean(axis=0)]) + com
        grip = GripContacts(pads, touch.normals[[0, 4]])
        push = PushContact(pushing.touch.anchors[0] + com, pushing.touch.normals[0])
        goal = lift_goal(balance_program(scene), R_world_plate, grip, push)
        if goal is None:
            return None
        each = dict(zip(goal.balance.contacts, goal.balance.wrenches_world, strict=True))
        fingers = np.array([each["grip_0"], each["grip_1"]])
        total = fingers.sum(axis=0)
        total[3:] += np.cross((pads - pads.mean(axis=0)) @ R_world_plate.T, fingers[:, :3]).sum(axis=0)
        wrenches = {gripping.arm.name: total, pushing.arm.name: each["push"], "cup": each["cup"]}
        push = float(each["push"][2])
        gains = _gains(scene, R_world_plate[2], gripping, pushing, com)
        return cls(goal, wrenches, push, push + float(total[2]), gains)


class CooperativeLift:
    """Eq. (11) on the vertical force of both hands; both rise with the same velocity along their path."""

    def __init__(
        self,
        scene: PlateLiftScene,
        forces: LiftForces,
        path: LiftPath,
        begin: float,
        settings: SimulationSettings,
        rng: np.random.Generator,
    ) -> None:
        """Draw the winch's profile and set the hands' law up.

        Args:
            scene: plate and cup, for the gains, and the joints' limits.
            forces: F_goal.
            path: of both arms upward.
            begin: when the lift begins [s].
            settings: see there.
            rng: for the winch.
        """
        self.forces, self.path, self.begin = forces, path, begin
        travel = max(0.0, path.height - settings.headroom)
        self.winch = WinchProfile.draw(travel, settings.step, rng, settings.winch)
        self.end = begin + self.winch.duration + settings.rest
        """[s]"""
        self.velocity, self.height = 0.0, 0.0
        """Of the hands, commanded [m/s, m]."""
        self._goal_velocity, self._left = 0.0, 0.0
        self.gains = settings.follower or forces.gains
        limits = np.concatenate([arm.velocity_max for arm in scene.cell.arms.values()])
        self._usual_speed = settings.winch.usual_speed
        self._law = LeaderFollower(self.gains)
        self._fastest = _LIMIT_SHARE * path.speed_limits(limits)
        self._motion = FollowerMotion()
        self._controlled = settings.controlled

    def command(self, reading: float) -> None:
        """Take the vertical force of both hands together [N] and set the velocity until the next reading.

        Without the controller the hands rise at the speed that such lifters usually have, as far as was agreed.
        """
        self._left = self._law.gains.period
        if self._controlled:
            fastest = float(np.interp(self.height, self.path.heights, self._fastest))
            self._motion = self._law.follow(self._motion, self.forces.both, reading, fastest)
            self._goal_velocity = self._motion.velocity
        else:
            self._goal_velocity = self._usual_speed if self.height < self.winch.heights[-1] else 0.0

    def advance(self, step: float) -> tuple[Array, Array]:
        """Rise for one step [s] and return the (12,) joint positions and velocities to be at then [rad, rad/s]."""
        if self.height >= self.path.height:
            self.velocity = self._goal_velocity = 0.0
            self._motion = replace(self._motion, velocity=0.0)
        self._left = max(self._left, step)
        self.velocity += (self._goal_velocity - self.velocity) * step / self._left
        self._left -= step
        self.height += self.velocity * step
        positions = self.path.at(self.height)
        slope = (self.path.at(self.height + _SLOPE_STEP) - positions) / _SLOPE_STEP
        return positions, slope * self.velocity

    def lifter(self, time: float) -> tuple[float, float]:
        """Return the winch's height [m] and speed [m/s] at a time [s]."""
        return self.winch.at(time - self.begin)


def _gains(scene: PlateLiftScene, up: Array, gripping: GrippingHand, pushing: PushingHand, com: Array) -> FollowerGains:
    """Return gains for a plate that hangs with `up` (3,) in its axes; `com` (3,) as the hands' contacts are told."""
    plate, cup = scene.plate, scene.cup
    mass = plate.mass or 1.0
    inertia = box_inertia(np.ptp(plate.solid.convex.vertices, axis=0), mass)
    places = [hand.touch.anchors.mean(axis=0) + com - plate.com for hand in (gripping, pushing)]
    hands = sum(
        (moved_stiffness(hand.touch.stiffness(), at) for hand, at in zip((gripping, pushing), places, strict=True)),
        start=np.zeros((6, 6)),
    )
    # A cable holds along itself alone.
    along = np.outer(up, up) if scene.lifter_model == "cable" else np.eye(3)
    pull = np.zeros((6, 6))
    pull[:3, :3] = gripping.settings.cup.stiffness(cup.max_force) * along
    hung = HungPlate(
        mass,
        inertia,
        hands,
        gripping.settings.contact.damping_time,
        moved_stiffness(pull, cup.T_plate_cup[:3, 3] - plate.com),
        gripping.settings.cup.damping_time,
        up,
    )
    return design_gains(hung, felt_mass(np.array(places), up, mass, inertia), cup.max_force)


def way_up(
    scene: PlateLiftScene, start: Array, corrections: Array, T_world_plate: Transform, arms: tuple[str, str]
) -> LiftPath:
    """Return how far both arms can go straight up with the plate, and how.

    Args:
        scene: the cell and what stands in it.
        start: (12,) where the plan ends [rad].
        corrections: (12,) by which force control has put the hands off the plan [rad].
        T_world_plate: the plate at the plan's end.
        arms: gripping and pushing.
    """
    gripper = scene.cell.arms[arms[0]]
    workcell = LiftWorkcell(scene, *arms)
    real = start + corrections
    first = 6 * list(scene.cell.arms).index(arms[0])
    T_world_flange = flange_pose(gripper.dh, gripper.T_world_base, real[first : first + 6].copy())
    # Hands, plate and cup go up alike: between them nothing changes, and pads give way further than hands look alone.
    risen = {*(f"{arm}/6" for arm in arms), PLATE_FRAME, workcell.cable_frame}

    def chosen(a: CollisionBody, b: CollisionBody) -> bool:
        moves = bool({a.group, b.group} & set(arms)) or workcell.lifted(a, b)
        return moves and not risen >= {a.frame, b.frame}

    held = Attached(gripper.name, inverse(T_world_flange) @ T_world_plate)
    query = workcell.query(workcell.holding, chosen, held, hands=arms)
    return lift_path(scene.cell.arms, real, query, resized(LiftPathSettings(), scene.cell.size, "largest_height"))
