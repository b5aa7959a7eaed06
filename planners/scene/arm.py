"""A robot, mounted somewhere, with a hand."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from planners.geometry.convex import CollisionBody
from planners.geometry.pose import Array, Transform, to_pose7s
from planners.kinematics.joint_torque import WeighedArm
from planners.plan.scenery import ArmDocument, LinkDocument
from planners.scene.hand import Gripper, Pusher
from planners.scene.robot import Robot


@dataclass(frozen=True, eq=False)
class Arm:
    """One arm of a cell. Frame "<name>/i" is its frame after i joints: 0 is the base, 6 the flange."""

    name: str
    robot: Robot
    T_world_base: Transform
    """The controller's base frame."""
    home: Array
    """(6,) where the joints rest [rad]."""
    hand: Gripper | Pusher

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Six names, unique in the cell."""
        return tuple(f"{self.name}_{joint}" for joint in self.robot.joint_names)

    @property
    def dh(self) -> Array:
        """(6, 4) columns a, alpha, d, theta0 [m, rad]."""
        return self.robot.dh

    @property
    def position_min(self) -> Array:
        """(6,) [rad]."""
        return self.robot.position_min

    @property
    def position_max(self) -> Array:
        """(6,) [rad]."""
        return self.robot.position_max

    @property
    def velocity_max(self) -> Array:
        """(6,) [rad/s]."""
        return self.robot.velocity_max

    @property
    def acceleration_max(self) -> Array:
        """(6,) [rad/s^2]."""
        return self.robot.acceleration_max

    @property
    def torque_max(self) -> Array:
        """(6,) [Nm]."""
        return self.robot.torque_max

    @cached_property
    def masses(self) -> Array:
        """(7, 4) of the six links that move, then of the hand: mass [kg], and centre of mass [m].

        Link i is in frame i + 1, the hand in frame 6, the flange.
        """
        return np.vstack([self.robot.masses, [self.hand.mass, *self.hand.com]])

    def weighed(self, gravity: Array) -> WeighedArm:
        """Return what joint torques follow from; `gravity` is (3,) in the world [m/s^2]."""
        return WeighedArm(self.dh, self.T_world_base, self.masses, np.asarray(gravity, dtype=float))

    @property
    def spare_payload(self) -> float:
        """Largest mass that the hand may carry: the payload less what is mounted on the flange [kg]."""
        return self.robot.payload - self.hand.mass

    def link_bodies(self) -> tuple[CollisionBody, ...]:
        """Return the links "<name>_base" to "<name>_wrist_3"; link i is in frame "<name>/i"."""
        return tuple(
            CollisionBody(f"{self.name}_{link.name}", self.name, f"{self.name}/{i}", (link.shape,))
            for i, link in enumerate(self.robot.links)
        )

    def hand_bodies(self, width: float | None) -> tuple[CollisionBody, ...]:
        """Return the bodies of the hand; `width` is the opening of a gripper [m], the widest when None."""
        if isinstance(self.hand, Pusher):
            return self.hand.bodies(self.name)
        return self.hand.bodies(self.name, self.hand.width_max if width is None else width)

    def document(self) -> ArmDocument:
        """Return the entry of a plan's `cell.arms`."""
        return ArmDocument(
            base=to_pose7s(self.T_world_base[None])[0],
            dh=self.dh,
            position_min=self.position_min,
            position_max=self.position_max,
            velocity_max=self.velocity_max,
            acceleration_max=self.acceleration_max,
            torque_max=self.torque_max,
            links=tuple(LinkDocument(mass=mass, com=np.array(com)) for mass, *com in self.robot.masses.tolist()),
            payload=self.robot.payload,
        )
