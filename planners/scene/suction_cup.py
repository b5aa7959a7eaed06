"""The vacuum lifter's cup on the plate, and the cable it hangs from."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from planners.contract.shapes import Cylinder
from planners.contract.task_spec import LifterCup
from planners.geometry.convex import CollisionBody
from planners.geometry.pose import Array, Transform, frame_from_z, transform
from planners.geometry.shapes import capsule
from planners.scene.body import Body, Plate
from planners.scene.solid import solid_of


@dataclass(frozen=True)
class LifterShape:
    """The bodies that stand for the vacuum lifter: the contract's cable, and a cup as tall as common bellows."""

    cup_height: float = 0.04
    """[m]"""
    cable_radius: float = 0.010
    """[m]"""
    cable_length: float = 1.1
    """[m]"""


DEFAULT_LIFTER = LifterShape()


@dataclass(frozen=True, eq=False)
class SuctionCup:
    """A cup that sits on the plate's top face from the first sample to the last."""

    T_plate_cup: Transform
    """Contact frame: origin in the pad's centre, z into the plate, x the plate's x, y = z cross x."""
    position: Array
    """(2,) pad centre on the top face, in plate axes [m]."""
    radius: float
    """[m]"""
    max_force: float
    """Largest suction force [N]."""
    mu: float
    kappa: float
    """[N], see the suction model."""
    body: Body
    """Cylinder on the top face; its frame is at mid-height, with the plate's axes."""
    T_plate_cup_body: Transform
    """Where `body` rides on the plate."""
    cable: Body
    """Vertical cylinder that follows the cup's top and never tilts; its frame is at mid-height, with world axes."""
    cable_anchor: Array
    """(3,) lower end of the cable in the plate's frame: the centre of the cup's top [m]."""
    cable_length: float
    """[m]"""

    def cable_collision_body(self) -> CollisionBody:
        """Return the cable for collision queries in the upright frame "cable_end", with its lower end at the origin.

        A capsule around the cylinder: it is longer by its radius at both ends, where cup and trolley are.
        """
        axis = capsule([0.0, 0.0, 0.0], [0.0, 0.0, self.cable_length], self._cable_radius)
        return CollisionBody(self.cable.name, "cable", "cable_end", (axis,))

    @property
    def _cable_radius(self) -> float:
        assert isinstance(self.cable.shape, Cylinder)
        return self.cable.shape.radius


def place_cup(cup: LifterCup, plate: Plate, lifter: LifterShape) -> SuctionCup:
    """Put the cup on the plate where the plate is at the start."""
    x, y = cup.position
    T_plate_cup = transform(frame_from_z([0.0, 0.0, -1.0], [1.0, 0.0, 0.0]), [x, y, plate.top])
    T_plate_cup_body = transform(position=[x, y, plate.top + 0.5 * lifter.cup_height])
    anchor = np.array([x, y, plate.top + lifter.cup_height])
    T_world_cable = transform(position=plate.T_world_body[:3, :3] @ anchor + plate.T_world_body[:3, 3])
    T_world_cable[2, 3] += 0.5 * lifter.cable_length
    pad = Cylinder(type="cylinder", radius=cup.radius, height=lifter.cup_height)
    rope = Cylinder(type="cylinder", radius=lifter.cable_radius, height=lifter.cable_length)
    return SuctionCup(
        T_plate_cup=T_plate_cup,
        position=np.array([x, y]),
        radius=cup.radius,
        max_force=cup.max_force,
        mu=cup.mu,
        kappa=cup.kappa,
        body=_massless("cup", pad, plate.T_world_body @ T_plate_cup_body),
        T_plate_cup_body=T_plate_cup_body,
        cable=_massless("cable", rope, T_world_cable),
        cable_anchor=anchor,
        cable_length=lifter.cable_length,
    )


def _massless(name: Literal["cup", "cable"], shape: Cylinder, T_world_body: Transform) -> Body:
    # The lifter bears its own weight: the plate does not feel cup and cable.
    return Body(name, name, shape, solid_of(shape), None, np.zeros(3), T_world_body, static=False)
