"""The cooperative lift: the winch goes up as it likes, and the hands follow what the pushing one feels."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from planners.balance.contacts import GripContacts, PushContact
from planners.collision.placement import Attached
from planners.geometry.pose import Array, Transform, inverse
from planners.kinematics.forward import flange_pose
from planners.lifting.leader_follower import FollowerGains, FollowerMotion, LeaderFollower
from planners.lifting.lift_goal import LiftGoal, lift_goal
from planners.lifting.lift_path import LiftPath, LiftPathSettings, lift_path
from planners.manipulation.workcell import LiftWorkcell
from planners.scene.scene import PlateLiftScene
from workers.simulation.hands import GrippingHand, PushingHand
from workers.simulation.settings import SimulationSettings
from workers.simulation.winch import WinchProfile

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

    @classmethod
    def find(
        cls, scene: PlateLiftScene, R_world_plate: Array, gripping: GrippingHand, pushing: PushingHand
    ) -> Self | None:
        """Solve (5) for the plate hanging in this orientation; None: hands and cup cannot bear it."""
        com, touch = scene.plate.com, gripping.touch
        pads = np.array([touch.anchors[:4].mean(axis=0), touch.anchors[4:].mean(axis=0)]) + com
        grip = GripContacts(pads, touch.normals[[0, 4]])
        push = PushContact(pushing.touch.anchors[0] + com, pushing.touch.normals[0])
        goal = lift_goal(scene, R_world_plate, grip, push)
        if goal is None:
            return None
        each = dict(zip(goal.balance.contacts, goal.balance.wrenches_world, strict=True))
        fingers = np.array([each["grip_0"], each["grip_1"]])
        total = fingers.sum(axis=0)
        total[3:] += np.cross((pads - pads.mean(axis=0)) @ R_world_plate.T, fingers[:, :3]).sum(axis=0)
        wrenches = {gripping.arm.name: total, pushing.arm.name: each["push"], "cup": each["cup"]}
        return cls(goal, wrenches, float(each["push"][2]))


class CooperativeLift:
    """Eq. (11) on the pushing hand's vertical force; both hands rise with the same velocity along their path."""

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
        gains = settings.follower or FollowerGains.for_lift(scene.plate.mass or 1.0, scene.cup.max_force)
        limits = np.concatenate([arm.velocity_max for arm in scene.cell.arms.values()])
        self._usual_speed = settings.winch.usual_speed
        # With V_d = 0 hands that follow always bear less than F_goal, and the cup more: the lifter's usual speed would
        # use its reserve up. With V_d at that speed F_goal holds there, and the reserve is for what is uneven.
        fastest = _LIMIT_SHARE * path.largest_speed(limits)
        self._law = LeaderFollower(gains, min(self._usual_speed, fastest), fastest)
        self._motion = FollowerMotion()
        self._controlled = settings.controlled

    def command(self, push_reading: float) -> None:
        """Take the pushing hand's vertical force [N] and set the velocity until the next reading.

        Without the controller the hands rise at the speed that such lifters usually have, as far as was agreed.
        """
        if self._controlled:
            self._motion = self._law.follow(self._motion, self.forces.push, push_reading)
            self.velocity = self._motion.velocity
        else:
            self.velocity = self._usual_speed if self.height < self.winch.heights[-1] else 0.0

    def advance(self, step: float) -> tuple[Array, Array]:
        """Rise for one step [s] and return the (12,) joint positions and velocities to be at then [rad, rad/s]."""
        if self.height >= self.path.height:
            self.velocity, self._motion = 0.0, replace(self._motion, velocity=0.0)
        self.height += self.velocity * step
        positions = self.path.at(self.height)
        slope = (self.path.at(self.height + _SLOPE_STEP) - positions) / _SLOPE_STEP
        return positions, slope * self.velocity

    def lifter(self, time: float) -> tuple[float, float]:
        """Return the winch's height [m] and speed [m/s] at a time [s]."""
        return self.winch.at(time - self.begin)


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
    first = 6 * list(scene.cell.arms).index(arms[0])
    T_world_flange = flange_pose(gripper.dh, gripper.T_world_base, start[first : first + 6].copy())
    query = workcell.query(
        workcell.holding,
        lambda a, b: bool({a.group, b.group} & set(arms)) or workcell.lifted(a, b),
        Attached(gripper.name, inverse(T_world_flange) @ T_world_plate),
        hands=arms,
    )
    planned = lift_path(scene.cell.arms, start, query)
    # The hands start some millimetres off the plan; for collisions they are where it has them.
    reach = LiftPathSettings(largest_height=planned.height)
    return replace(lift_path(scene.cell.arms, start + corrections, None, reach), end=planned.end)
