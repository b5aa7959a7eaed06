"""How far from its shoulder an arm can touch anything at all, in whatever posture."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Self

import numpy as np

from planners.cell.arm import Arm
from planners.cell.hand import Gripper
from planners.geometry.pose import Array

SLACK = 0.010
"""Added to what an arm spans [m]: more than all tolerances of where bodies rest, are held and end."""


@dataclass(frozen=True, eq=False)
class ArmSpan:
    """A ball that no point leaves with which a hand grips or pushes."""

    arm: str
    center: Array
    """(3,) where the first joint's axis leaves the second's: no joint moves it [m]."""
    radius: float
    """[m]"""

    @classmethod
    def of(cls, arm: Arm) -> Self:
        """Bound an arm's reach: sound for every posture, as every joint is given all the freedom there is.

        From one joint's frame to the next, Denavit and Hartenberg's row goes d along the first axis and a across it,
        whatever the joint's angle. The first row's d is along the axis that the base holds.
        """
        a, d = arm.dh[:, 0], arm.dh[:, 2]
        center = arm.T_world_base[:3, :3] @ [0.0, 0.0, d[0]] + arm.T_world_base[:3, 3]
        links = abs(float(a[0])) + float(np.hypot(a[1:], d[1:]).sum())
        return cls(arm.name, center, links + _hand_span(arm) + SLACK)

    def distance(self, point: Array) -> float:
        """Return the distance of a point (3,) of the world from the center [m]."""
        return float(np.linalg.norm(point - self.center))


def _hand_span(arm: Arm) -> float:
    """Return the distance from the flange's origin to the farthest point of a pad's face, or of the tip [m]."""
    hand = arm.hand
    if not isinstance(hand, Gripper):
        return float(np.linalg.norm(hand.T_flange_tcp[:3, 3])) + hand.tip_radius
    width, _, length = hand.pad_size
    corner = [0.5 * width, 0.5 * hand.width_max, float(hand.tcp_table[:, 1].max()) + 0.5 * length]
    return float(np.linalg.norm(corner))


@dataclass(frozen=True)
class OutOfReach:
    """A point that no arm reaches, with the numbers of the arm that misses it by least."""

    needed: float
    """From its shoulder to the point [m]."""
    available: float
    """What it spans, with what it may hold and what is around the point [m]."""


def out_of_reach(spans: Iterable[ArmSpan], point: Array, further: float) -> OutOfReach | None:
    """Return the numbers that prove that no arm reaches a point, or None where they do not.

    Args:
        spans: of the arms, one of which would have to reach it.
        point: (3,) in the world [m].
        further: what a hand may reach with, and how far around the point it may touch [m].
    """
    nearest = min(spans, key=lambda span: span.distance(point) - span.radius)
    found = OutOfReach(nearest.distance(point), nearest.radius + further)
    return found if found.needed > found.available else None
