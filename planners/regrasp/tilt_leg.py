"""Turning a level tool about the centre of mass of what hangs on it.

A cup pulls and never pushes. On a level tool it does neither: the least acceleration of the object towards the cup is a
push, however slow the motion. The object's centre of mass does not accelerate where everything turns about it, so that
is how a level tool is reached and left; all other motion of an object keeps off the level.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from planners.geometry.pose import Array, Transform, rotation_from_vector

_UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, eq=False)
class TiltLeg:
    """The flange turns about a point that stays where it is, the centre of mass of what is carried."""

    T_world_flange: Transform
    """Where it begins."""
    pivot: Array
    """(3,) in the world [m]."""
    turn: Array
    """(3,) rotation vector in the world [rad]."""

    @property
    def length(self) -> float:
        """How far the flange goes: angle times its distance from the pivot [m]."""
        return float(np.linalg.norm(self.turn) * np.linalg.norm(self.T_world_flange[:3, 3] - self.pivot))

    def at(self, part: Array) -> Array:
        """Return the flange poses (n, 4, 4) at parts (n,) of the turn."""
        return np.array([turned_about(self.T_world_flange, self.pivot, each * self.turn) for each in part])

    def back(self) -> TiltLeg:
        """Return the same turn the other way."""
        return TiltLeg(turned_about(self.T_world_flange, self.pivot, self.turn), self.pivot, -self.turn)


def raising(T_world_tool: Transform, tilt: float) -> Array:
    """Return the rotation vector (3,) that takes the tool's axis to `tilt` from straight up, the shortest way [rad]."""
    axis = T_world_tool[:3, 2]
    across = np.cross(axis, _UP)
    sine = float(np.linalg.norm(across))
    return (math.atan2(sine, float(axis[2])) - tilt) / sine * across


def tilt_of(T_world_tool: Transform) -> float:
    """Return the angle between the tool's axis and straight up [rad]."""
    axis = T_world_tool[:3, 2]
    return math.atan2(math.hypot(axis[0], axis[1]), float(axis[2]))


def turned_about(T: Transform, pivot: Array, turn: Array) -> Transform:
    """Return a pose (4, 4) turned by a rotation vector (3,) about a point (3,), all in the world."""
    turned, R = T.copy(), rotation_from_vector(turn)
    turned[:3, :3] = R @ T[:3, :3]
    turned[:3, 3] = pivot + R @ (T[:3, 3] - pivot)
    return turned
