"""How a hand on the plate exerts what is planned: it gives way to what it feels beyond that, and presses on below it.

Paper B plans the wrenches of both hands (5) and does not say how they are exerted. Positions alone exert none: pads
and tip are soft, and a plate on its edge needs its hands' forces where the plan has them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

from planners.cell.cell_size import resized, tip_stiffness
from planners.contract.quantities import SOFT_FINGER_EPS

LEAST_PUSH = 3.0
"""A stick never presses less while it is to push [N]: planned forces of zero would lose the contact."""


@dataclass(frozen=True)
class HandAdmittance:
    """x' = (w_planned - w_felt) / damping - leak x, where x [m, rad] is how far a hand is off its planned pose.

    Both wrenches [N, Nm] are of the hand on the plate, about its TCP, and in the same axes as x, whichever these are.
    The gripping hand turns likewise; a stick's tip exerts no torque.
    """

    damping: float = 1500.0
    """Of the admittance: a force error of 15 N moves the hand by 10 mm/s [Ns/m]."""
    torsional_damping: float = 3.0
    """Of the gripping hand's admittance about its pads: an error of 0.3 Nm turns it by 0.1 rad/s [Nms/rad]."""
    leak: float = 0.3
    """Rate at which a correction dies away [1/s]: what cannot be tracked does not wander off."""
    largest_correction: float = 0.012
    """Of the hand's place by feedback [m]."""
    largest_turning: float = 0.15
    """Of the gripping hand's orientation by feedback [rad]."""
    fading: float = 0.2
    """Time constant with which a hand that has let go takes back its correction [s]."""

    @classmethod
    def of(cls, tip_radius: float, push: float, eps: float) -> Self:
        """Return the admittance of the hands of a cell and task, as far as a plan's document tells of their rubber.

        How fast an error may be made good is up to sensors and servos, which are the same in every cell: a loop of
        contacts that are twice as stiff swings. So dampings grow as contacts get stiffer, and of turning as eps²
        besides. Nothing is less than in the papers' cell: a task that asks for less force, or trusts friction less, has
        the same rubber. How far a hand may be off its plan has no size, as what planning keeps from other bodies has
        none.

        Args:
            tip_radius: of the stick [m].
            push: the largest normal force that it may exert, at which its tip is stiffest [N].
            eps: at which pads bear a torque by friction [m].
        """
        stiffer = max(1.0, tip_stiffness(tip_radius, push))
        softly = resized(cls(), stiffer, "damping")
        return resized(softly, stiffer * max(1.0, eps / SOFT_FINGER_EPS) ** 2, "torsional_damping")
