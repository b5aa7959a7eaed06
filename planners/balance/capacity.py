"""Upper bounds of what hands and lifter can do at all, wherever they hold: closed form, and sound."""

from __future__ import annotations

import math
from dataclasses import dataclass

from planners.balance.contacts import Friction, HandLimits
from planners.balance.lifter import Lifter


@dataclass(frozen=True)
class LiftCapacity:
    """The weight of the plate against what can carry it off the table, all in N."""

    needed: float
    cup: float
    """Most vertical force of the lifter at any allowed tilt."""
    gripper: float
    pusher: float

    @property
    def available(self) -> float:
        """Upper bound of the vertical force of lifter and hands together."""
        return self.cup + self.gripper + self.pusher

    @property
    def suffices(self) -> bool:
        """False proves that no pose off the table can be held; true proves nothing."""
        return self.available >= self.needed


def lift_capacity(
    weight: float, lifter: Lifter, friction: Friction, limits: HandLimits, max_tilt: float
) -> LiftCapacity:
    """Bound what can carry a plate of `weight` [N] that touches nothing, tilted by at most `max_tilt` [rad].

    One gripping and one pushing hand, both at their best at once.
    """
    return LiftCapacity(
        needed=weight,
        cup=lifter.largest_lift(max_tilt),
        gripper=largest_grip_force(friction, limits),
        pusher=largest_push_force(friction, limits),
    )


def largest_grip_force(friction: Friction, limits: HandLimits) -> float:
    """Return an upper bound of the norm of the net force of two fingers [N]."""
    if limits.squeeze is not None:
        return min(limits.grip, limits.normal)
    return min(limits.grip, 2.0 * limits.normal * math.hypot(1.0, friction.grip))


def largest_push_force(friction: Friction, limits: HandLimits) -> float:
    """Return the largest norm of the force of one pushing contact [N]."""
    return min(limits.push, limits.normal * math.hypot(1.0, friction.push))


def largest_environment_normal(weight: float, lifter: Lifter, friction: Friction, limits: HandLimits) -> float:
    """Return a bound of the sum of the normal forces of whatever the plate stands on [N].

    They are vertical and their friction is horizontal: they carry the weight and what hands and lifter press down.
    """
    return weight + largest_grip_force(friction, limits) + largest_push_force(friction, limits) + lifter.largest_force()
