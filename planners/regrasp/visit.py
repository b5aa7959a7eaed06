"""Ways of a hand, one after the other, that one branch of the inverse kinematics follows all along."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from planners.cell.arm import Arm
from planners.geometry.pose import Array, Transform, inverse
from planners.kinematics.inverse import follow_branch
from planners.regrasp.tilt_leg import TiltLeg
from planners.regrasp.tool_stage import HeldGrasp

_TURN = 2.0 * math.pi
_WINDINGS = np.array([-_TURN, 0.0, _TURN])


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
    """Where an arm goes after a visit: whoever has a choice of postures and turns looks that far ahead."""

    positions: Array
    """(k, 6) any of them [rad]."""
    held: HeldGrasp | None = None
    """What it carries there."""


@dataclass(frozen=True, eq=False)
class Posture:
    """Joint positions along the legs of a visit, in one branch and with one choice of whole turns."""

    branch: int
    ways: tuple[Array, ...]
    """(m, 6) along each leg, evenly spaced, each starting where the one before ended [rad]."""

    @property
    def start(self) -> Array:
        """(6,) where the visit begins [rad]."""
        return self.ways[0][0]

    @property
    def end(self) -> Array:
        """(6,) where the visit ends [rad]."""
        return self.ways[-1][-1]

    def turned(self, turns: Array) -> Posture:
        """Return the posture after whole turns (6,) [rad]."""
        return Posture(self.branch, tuple(way + turns for way in self.ways))

    def windings(self, lo: Array, hi: Array) -> Array:
        """Return (k, 6) whole turns [rad] after which the whole visit is within limits."""
        everything = np.concatenate(self.ways)
        low, high = everything.min(axis=0), everything.max(axis=0)
        choices = [_WINDINGS[(low[i] + _WINDINGS >= lo[i]) & (high[i] + _WINDINGS <= hi[i])] for i in range(6)]
        return np.stack(np.meshgrid(*choices, indexing="ij"), axis=-1).reshape(-1, 6)


@dataclass(frozen=True, eq=False)
class Visit:
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
        way = posture.ways[leg]
        at = np.clip(part, 0.0, 1.0) * (len(way) - 1)
        below = np.minimum(at.astype(int), len(way) - 2)
        weight = (at - below)[:, None]
        reference = (1.0 - weight) * way[below] + weight * way[below + 1]
        return self.follow(self.legs[leg].at(part), posture.branch, reference)

    def follow(self, T_world_flanges: Array, branch: int, reference: Array | None = None) -> Array:
        """Return joint positions (n, 6) of a branch; see `follow_branch`."""
        near = np.empty((0, 6)) if reference is None else np.ascontiguousarray(reference)
        base = inverse(self.arm.T_world_base)
        return follow_branch(self.arm.dh, base, np.ascontiguousarray(T_world_flanges), branch, near)
