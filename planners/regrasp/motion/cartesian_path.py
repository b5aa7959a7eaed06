"""Cartesian legs: ways of a hand, one after the other, that one branch of the inverse kinematics follows all along.

A hand goes straight, or turns about the centre of mass of what hangs on it. A cup pulls and never pushes. On a level
tool it does neither: the least acceleration of the object towards the cup is a push, however slow the motion. The
object's centre of mass does not accelerate where everything turns about it, so that is how a level tool is reached and
left; all other motion of an object keeps off the level.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from planners.cell.arm import Arm
from planners.geometry.pose import Array, Transform, inverse, rotation_from_vector
from planners.hands.arm_motion import interpolated
from planners.kinematics.inverse import follow_branch
from planners.kinematics.windings import all_windings
from planners.regrasp.motion.scene_state import HeldGrasp

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


@dataclass(frozen=True, eq=False)
class StraightLeg:
    """The flange goes straight, without turning."""

    T_world_flange: Transform
    """Where it begins."""
    way: Array
    """(3,) in the world, from begin to end [m]."""

    @property
    def length(self) -> float:
        """How far [m]."""
        return float(np.linalg.norm(self.way))

    @property
    def end(self) -> Transform:
        """Where the flange is at the end."""
        return self.at(np.ones(1))[0]

    def at(self, part: Array) -> Array:
        """Return the flange poses (n, 4, 4) at parts (n,) of the way."""
        poses = np.repeat(self.T_world_flange[None], len(part), axis=0)
        poses[:, :3, 3] += part[:, None] * self.way
        return poses


Leg = StraightLeg | TiltLeg


@dataclass(frozen=True, eq=False)
class Onward:
    """Where an arm goes after a Cartesian path: whoever has a choice of postures and turns looks that far ahead."""

    positions: Array
    """(k, 6) any of them [rad]."""
    held: HeldGrasp | None = None
    """What it carries there."""


@dataclass(frozen=True, eq=False)
class Posture:
    """Joint positions along the legs of a Cartesian path, in one branch and with one choice of whole turns."""

    branch: int
    ways: tuple[Array, ...]
    """(m, 6) along each leg, evenly spaced, each starting where the one before ended [rad]."""

    @property
    def start(self) -> Array:
        """(6,) where the path begins [rad]."""
        return self.ways[0][0]

    @property
    def end(self) -> Array:
        """(6,) where the path ends [rad]."""
        return self.ways[-1][-1]

    def turned(self, turns: Array) -> Posture:
        """Return the posture after whole turns (6,) [rad]."""
        return Posture(self.branch, tuple(way + turns for way in self.ways))

    def windings(self, lo: Array, hi: Array) -> Array:
        """Return (k, 6) whole turns [rad] after which the whole path is within limits."""
        everything = np.concatenate(self.ways)
        return all_windings(np.zeros(6), lo - everything.min(axis=0), hi - everything.max(axis=0))


@dataclass(frozen=True, eq=False)
class CartesianPath:
    """Legs of one arm's hand; each begins where the one before ended."""

    arm: Arm
    legs: tuple[Leg, ...]

    def postures(self, branches: int, step: float, continuity: float) -> Iterator[Posture]:
        """Yield the joint positions of each branch in a bit set that reaches all of the way without a jump.

        Args:
            branches: bit k for branch k.
            step: largest way between samples [m].
            continuity: largest joint step between them [rad].
        """
        counts = [2 + math.ceil(leg.length / step) for leg in self.legs]
        poses = [leg.at(np.linspace(0.0, 1.0, count)) for leg, count in zip(self.legs, counts, strict=True)]
        everywhere = np.concatenate(poses)
        for branch in range(8):
            if not branches >> branch & 1:
                continue
            q = self.follow(everywhere, branch)
            if np.isfinite(q).all() and np.abs(np.diff(q, axis=0)).max() <= continuity:
                yield Posture(branch, tuple(np.split(q, np.cumsum(counts)[:-1])))

    def exact(self, leg: int, part: Array, posture: Posture) -> Array:
        """Return joint positions (n, 6) at parts (n,) of a leg, in the turns of a posture [rad]."""
        return self.follow(self.legs[leg].at(part), posture.branch, interpolated(posture.ways[leg], part))

    def follow(self, T_world_flanges: Array, branch: int, reference: Array | None = None) -> Array:
        """Return joint positions (n, 6) of a branch; see `follow_branch`."""
        near = np.empty((0, 6)) if reference is None else np.ascontiguousarray(reference)
        base = inverse(self.arm.T_world_base)
        return follow_branch(self.arm.dh, base, np.ascontiguousarray(T_world_flanges), branch, near)
