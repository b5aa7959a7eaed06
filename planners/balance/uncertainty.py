"""What is not known of a plate's weight: its mass within a share, its centre of mass within a box.

For fixed friction and limits the wrenches that contacts can balance are a convex set that contains zero: forces of none
balance nothing, and a squeeze balances itself. Gravity's wrench is linear in (m, m c). So if the heaviest plate can be
held with its centre of mass at every corner of the box, every plate within the tolerances can: a point of the box is a
mean of its corners, and a lighter plate's wrench lies between a heavier one's and zero.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from planners.errors import LiftwrightError
from planners.geometry.pose import Array


@dataclass(frozen=True)
class Uncertainty:
    """Tolerances of a plate's mass and centre of mass."""

    mass: float = 0.0
    """Share of the mass by which it may be more or less [1]."""
    com: float = 0.0
    """Distance along each of the plate's axes by which the centre of mass may be off, either way [m]."""

    def __post_init__(self) -> None:
        if not (0.0 <= self.mass < 1.0 and self.com >= 0.0):
            raise LiftwrightError(f"a tolerance of {self.mass} of the mass and {self.com} m cannot be")

    @property
    def is_none(self) -> bool:
        """Whether mass and centre of mass are known exactly."""
        return self.mass == 0.0 and self.com == 0.0

    def corners(self, up: Array) -> Array:
        """Return the displacements of the centre of mass (k, 3) whose wrenches are the corners of all there may be [m].

        Only what is square to the vertical changes a torque, so that a box leaves a polygon of six corners at most.

        Args:
            up: (3,) unit, world +z in plate axes.
        """
        if self.com == 0.0:
            return np.zeros((1, 3))
        # Seen along the vertical, each axis of the box is an arrow in a plane. Between the directions in which one of
        # them does not count, the farthest corner stays the same; so it is taken on either side of each of those.
        # Arrows that are parallel stop counting together.
        ux, uy, uz = (float(part) for part in up)
        seen = ((0.0, uz, -uy), (-uz, 0.0, ux), (uy, -ux, 0.0))
        signs = set()
        for along in seen:
            if max(abs(part) for part in along) <= _PARALLEL:
                continue
            beside = [sum(a * b for a, b in zip(arrow, along, strict=True)) for arrow in seen]
            for side in (1.0, -1.0):
                for own in (1.0, -1.0):
                    corner = (
                        math.copysign(1.0, part) if abs(part) > _PARALLEL else own * ((near > 0.0) - (near < 0.0))
                        for part, near in zip([side * part for part in along], beside, strict=True)
                    )
                    signs.add(tuple(corner))
        return self.com * np.array(sorted(signs))

    def least_power(self, weight: float, twists: Array, ups: Array) -> Array:
        """Return the power of gravity (...) along twists for the plate that it helps least [W].

        Args:
            weight: of the plate as stated [N].
            twists: (..., 6) of the plate, plate axes, about the stated centre of mass.
            ups: (..., 3) unit, world +z in plate axes.
        """
        rising = np.sum(twists[..., :3] * ups, axis=-1)
        turning = np.abs(np.cross(ups, twists[..., 3:])).sum(axis=-1)
        highest = rising + self.com * turning
        return -weight * highest * np.where(highest > 0.0, 1.0 + self.mass, 1.0 - self.mass)


_PARALLEL = 1e-12
"""Two directions whose product is smaller are square to one another [1]."""
