"""Where a movable frame stands during a query."""

from __future__ import annotations

from dataclasses import dataclass

from planners.geometry.pose import Array, Transform


@dataclass(frozen=True, eq=False)
class Fixed:
    """At rest in the world."""

    T_world_body: Transform


@dataclass(frozen=True, eq=False)
class Attached:
    """Held by the flange of an arm."""

    arm: str
    T_flange_body: Transform


@dataclass(frozen=True, eq=False)
class Riding:
    """Rigid on another frame, like the cup on the plate."""

    frame: str
    T_parent_body: Transform


@dataclass(frozen=True, eq=False)
class Upright:
    """Axes of the world, origin at a point of another frame, like the cable above the cup."""

    frame: str
    point: Array
    """(3,), in that frame [m]."""


Placement = Fixed | Attached | Riding | Upright
