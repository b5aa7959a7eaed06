"""The answer of the balance program: wrenches that hold the plate, or why there are none."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from functools import cached_property

import numpy as np

from planners.balance.contacts import GripContacts, PushContact
from planners.geometry.pose import Array
from planners.geometry.wrench import rotated


class UnbalanceReason(Enum):
    """Why the plate cannot be held. The value is the sentence shown to a person."""

    PROVEN = "No forces within their limits balance the plate's weight."
    WITHIN_TOLERANCE = "The plate is on the border of what can be held; it counts as not held."


@dataclass(frozen=True, eq=False)
class HeldPlate:
    """How a plate is held: what is asked of program (5)."""

    rotation_world_plate: Array
    """(3, 3)"""
    environment_points: Array
    """(k, 3), where the plate stands on the table or support, plate frame [m]."""
    grip: GripContacts | None
    push: PushContact | None


@dataclass(frozen=True, eq=False)
class Balanced:
    """Least-effort wrenches (5). A cup's pull outward is a negative z force in its contact frame."""

    held: HeldPlate
    """What was asked."""
    contacts: tuple[str, ...]
    """The names of the contacts, in the order of the arrays below: "grip_0", "grip_1", "push", "environment_0"...,
    "cup"."""
    frames: Callable[[], tuple[Array, Array]]
    """Gives `points` and `rotations`; a search asks for them at few of its many answers."""
    exerted: Callable[[], Array]
    """Gives `wrenches_contact`, likewise."""
    hand_wrenches: Array
    """(2, 6), total of the gripper's and of the stick's contacts, plate axes, about the centre of mass."""
    objective: float
    """(5a): k_gp f+_gp + k_s f+_s."""
    f_plus_gp: float
    """Largest effort of a hand [N]: normal force of the stick, net force of a squeezing gripper, normal force of free
    fingers; 0 without a hand."""
    suction_force: float
    """Net pull of the cup, or tension of the cable [N]; f+_s of (5a), which is minimised down to it."""
    least_slack: float
    """Distance to the nearest limit, in N (torques over their contact's length)."""

    @cached_property
    def points(self) -> Array:
        """(m, 3), contact points in the plate frame [m]."""
        return self.frames()[0]

    @cached_property
    def rotations(self) -> Array:
        """(m, 3, 3), axes of the contact frames in the plate frame; z is the normal into the plate."""
        return self.frames()[1]

    @cached_property
    def wrenches_contact(self) -> Array:
        """(m, 6), in the contact frames."""
        return self.exerted()

    @cached_property
    def wrenches_world(self) -> Array:
        """(m, 6), in world axes, each about its contact point."""
        forces = np.einsum("mij,mj->mi", self.rotations, self.wrenches_contact[:, :3])
        torques = np.einsum("mij,mj->mi", self.rotations, self.wrenches_contact[:, 3:])
        return rotated(self.held.rotation_world_plate, np.concatenate([forces, torques], axis=1))


@dataclass(frozen=True, eq=False)
class UnbalanceProof:
    """A twist with which every allowed force loses power: by virtual power there is no balance.

    Were the plate to move so, all contacts together could put less power into it than its weight takes out.
    """

    twist: Array
    """(6,), [linear; angular] of the plate, plate axes, about the centre of mass; its larger part is of size 1."""
    net_multiplier: Array
    """(3,), velocity that makes the gripper's bound exact; see `contact_power.grip_power`."""


@dataclass(frozen=True, eq=False)
class Unbalanced:
    """No wrenches within the limits hold the plate."""

    reason: UnbalanceReason
    proof: UnbalanceProof | None
    """Re-checked in closed form; none when the reason is not PROVEN."""
    power: float
    """The most power of contacts and weight together along the proof's twist [W]; negative; 0 without proof."""
