"""What a cup can hold: the suction cones of a hand-held tool, in Dex-Net's form.

The cup exerts on the object a wrench `[fx fy fz tx ty tz]` about the centre of its lip, in the axes of the tool: fz is
the pull outward, f and t below the parts square to the pad's normal. With V the cup's largest force and r its radius

    0 <= fz <= V,   sqrt(3) |f| <= mu (V - fz),   sqrt(3) |tz| <= r mu (V - fz),   sqrt(2) |t| <= pi r kappa.

Dex-Net bounds x and y one by one. We bound |f| and |t|: then the bounds hold for x and y in any axes of the pad, those
of the object and those of the tool, and a roll of the tool changes nothing, as it does for a round pad.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum
from typing import Protocol

import numpy as np

from planners.geometry.pose import Array, Transform
from planners.geometry.wrench import wrench_about

_SQRT2, _SQRT3 = math.sqrt(2.0), math.sqrt(3.0)
_NO_PUSH = 1e-9
"""Share of the largest force below which a push is none: an upright pad neither pulls nor pushes."""


class CupStrength(Protocol):
    """What a suction cup bears."""

    @property
    def radius(self) -> float:
        """Of the lip [m]."""
        ...

    @property
    def max_force(self) -> float:
        """Largest suction force [N]."""
        ...

    @property
    def mu(self) -> float:
        """Friction between lip and object."""
        ...

    @property
    def kappa(self) -> float:
        """How stiff the lip is against bending [N], see facts of the suction model."""
        ...


class SuctionLimit(StrEnum):
    """Which limit of the cup a wrench comes nearest to; the value is the sentence shown when it is exceeded."""

    PULL = "The object pulls off the cup."
    SLIP = "The object slips along the cup."
    TWIST = "The object twists about the cup."
    PEEL = "The object's torque peels the cup off."
    PUSH = "The object presses against the cup, which only pulls."


_LIMITS = tuple(SuctionLimit)


@dataclass(frozen=True)
class HoldMargin:
    """The weakest moment of a hold."""

    margin: float
    """As of `suction_margin`: negative where the cup lets go."""
    sample: int
    limit: SuctionLimit
    figures: tuple[float, float, str]
    """What is asked of the cup there, what it has, and the unit."""

    @property
    def holds(self) -> bool:
        """Whether the cup holds at every moment."""
        return self.margin >= 0.0


def suction_margins(wrenches: Array, cup: CupStrength) -> Array:
    """Return (..., 5): the part of each limit, in the order of `SuctionLimit`, that a wrench leaves unused.

    A wrench can grow by 1 / (1 - margin) before it meets a limit. The last has no such measure: it is 1 while the cup
    pulls or does nothing, and minus the push over V otherwise.

    Args:
        wrenches: (..., 6) that the cup exerts on the object about the lip's centre, tool axes [N, Nm].
        cup: what exerts them.
    """
    pull = wrenches[..., 2]
    shear = np.hypot(wrenches[..., 0], wrenches[..., 1])
    bend = np.hypot(wrenches[..., 3], wrenches[..., 4])
    twist = np.abs(wrenches[..., 5])
    strength = cup.max_force
    peel = math.pi * cup.radius * cup.kappa
    return np.stack(
        [
            1.0 - pull / strength,
            1.0 - (_SQRT3 * shear / cup.mu + pull) / strength,
            1.0 - (_SQRT3 * twist / (cup.radius * cup.mu) + pull) / strength,
            1.0 - _SQRT2 * bend / peel,
            np.where(pull >= -_NO_PUSH * strength, 1.0, pull / strength),
        ],
        axis=-1,
    )


def suction_margin(wrenches: Array, cup: CupStrength) -> Array:
    """Return (...) the least of `suction_margins`: 1 where nothing is held, 0 at a limit, negative beyond."""
    return suction_margins(wrenches, cup).min(axis=-1)


def cup_uses(wrenches: Array, cup: CupStrength) -> Array:
    """Return (..., 5): to which part of themselves force, friction and stiffness of the cup could shrink [1].

    In the order of `SuctionLimit`: with so much of them each limit is just kept; more than 1 where it is exceeded. Slip
    and twist depend on both force and friction: sqrt(3) |f| <= u mu (u V - fz) has the least u in closed form. No cup
    bears a push, however strong it is: 0, or 1 and the push over V.
    """
    pull = wrenches[..., 2]
    shear = _SQRT3 * np.hypot(wrenches[..., 0], wrenches[..., 1]) / cup.mu
    twist = _SQRT3 * np.abs(wrenches[..., 5]) / (cup.radius * cup.mu)
    bend = np.hypot(wrenches[..., 3], wrenches[..., 4])
    strength = cup.max_force
    slips, twists = (0.5 * (pull + np.sqrt(pull**2 + 4.0 * strength * each)) / strength for each in (shear, twist))
    return np.stack(
        [
            np.maximum(pull, 0.0) / strength,
            slips,
            twists,
            _SQRT2 * bend / (math.pi * cup.radius * cup.kappa),
            np.where(pull >= -_NO_PUSH * strength, 0.0, 1.0 - pull / strength),
        ],
        axis=-1,
    )


def least_margin(wrenches: Array, cup: CupStrength) -> HoldMargin:
    """Return the weakest moment of a hold with wrenches (n, 6) over time, n > 0."""
    margins = suction_margins(wrenches, cup)
    sample, number = np.unravel_index(int(np.argmin(margins)), margins.shape)
    wrench, limit = wrenches[sample], _LIMITS[number]
    if limit in (SuctionLimit.SLIP, SuctionLimit.TWIST) and wrench[2] >= cup.max_force:
        # No friction is left, however little is asked of it.
        limit = SuctionLimit.PULL
    return HoldMargin(float(margins[sample, number]), int(sample), limit, _figures(wrench, limit, cup))


def _figures(wrench: Array, limit: SuctionLimit, cup: CupStrength) -> tuple[float, float, str]:
    pull, shear = float(wrench[2]), math.hypot(wrench[0], wrench[1])
    # A pull takes from what friction has for forces and torques along the pad.
    friction = cup.mu * max(0.0, cup.max_force - pull) / _SQRT3
    match limit:
        case SuctionLimit.PULL:
            return pull, cup.max_force, "N"
        case SuctionLimit.SLIP:
            return shear, friction, "N"
        case SuctionLimit.TWIST:
            return abs(float(wrench[5])), cup.radius * friction, "Nm"
        case SuctionLimit.PEEL:
            return math.hypot(wrench[3], wrench[4]), math.pi * cup.radius * cup.kappa / _SQRT2, "Nm"
        case SuctionLimit.PUSH:
            return -pull, 0.0, "N"


def cup_wrenches(loads: Array, T_world_objects: Array, com: Array, T_object_tool: Transform) -> Array:
    """Return the wrenches with which a cup alone bears loads.

    Args:
        loads: (..., 6) on the object about its centre of mass, world axes: weight, and what inertia adds [N, Nm].
        T_world_objects: (..., 4, 4).
        com: (3,) in the object's frame [m].
        T_object_tool: (..., 4, 4) where the cup is.

    Returns:
        (..., 6) that the cup exerts on the object about the lip's centre, tool axes.
    """
    T_world_tools = T_world_objects @ T_object_tool
    centres = T_world_objects[..., :3, :3] @ com + T_world_objects[..., :3, 3]
    borne = -wrench_about(loads + np.zeros((*T_world_tools.shape[:-2], 6)), centres, T_world_tools[..., :3, 3])
    pairs = borne.reshape(*borne.shape[:-1], 2, 3)
    return (pairs @ T_world_tools[..., :3, :3]).reshape(borne.shape)


def weight(mass: float, gravity: Array) -> Array:
    """Return the load (6,) of a body's weight about its centre of mass, world axes [N, Nm]; `gravity` (3,) [m/s^2]."""
    return np.array([*(mass * gravity), 0.0, 0.0, 0.0])
