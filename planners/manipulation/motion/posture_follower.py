"""Which posture each hand takes along a path: one per hold phase, the time in which a hand stays on the plate.

A path through the Manipulation State Graph promises a posture at every node, not that it is the same one. Here the
postures are followed along all motions of the path, hands are matched against one another, and what cannot be is
reported as a failure that the search must respect.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from planners.cell.cell import Cell
from planners.cell.cell_size import resized
from planners.collision.model import CollisionQuery
from planners.geometry.pose import Array
from planners.hands.arm_motion import among_all, touching
from planners.hands.workcell import Clearance
from planners.manipulation.contacts.dense_contact_states import DenseContactStateGraph, PlateMotion
from planners.manipulation.holds.grips import PlateGrip
from planners.manipulation.holds.pushes import PlatePush
from planners.manipulation.reach.hand_reach import Hand, HandReach, PlateQuery
from planners.manipulation.reach.reached_postures import ReachedPostures


@dataclass(frozen=True)
class SweepSettings:
    """How finely motions are sampled when postures are followed along them."""

    plate_step: float = 0.005
    """Largest way of any corner of the plate between samples [m]; clearances are kept at the samples."""
    approach_step: float = 0.005
    """Way of the hand between samples of an approach [m]."""
    grip_approach: float = 0.070
    """Straight way of the gripper onto the plate and off it [m]: the authors' value."""
    push_approach: float = 0.040
    """Straight way of the stick's tip onto the plate and off it [m]."""

    @classmethod
    def of(cls, cell: Cell) -> Self:
        """Return those of a cell: here they are of one of size 1 that keeps the usual margins."""
        ways = resized(cls(), cell.size, "grip_approach", "push_approach")
        return resized(ways, Clearance.of(cell).steps, "plate_step", "approach_step")


@dataclass(frozen=True, eq=False)
class PostureQueries:
    """Collision queries by step, the plate moving in all of them."""

    with_idle: dict[Hand, PlateQuery]
    """For each hand, its arm and the idle other arm against everything."""
    opened: dict[Hand, PlateQuery]
    """For each hand, its arm against everything but the other arm, while it comes to the plate."""
    beside: dict[Hand, CollisionQuery]
    """For each hand, the two arms against one another, while it comes to the plate that the other one is at."""
    lifted: PlateQuery
    """Plate and cup against what stands in the cell."""


class PostureFollower:
    """Follows postures along the motions of one plate lift; remembers every answer."""

    def __init__(
        self,
        poses: DenseContactStateGraph,
        reached: ReachedPostures,
        queries: PostureQueries,
        holds: tuple[tuple[PlateGrip, ...], tuple[PlatePush, ...]],
        settings: SweepSettings | None = None,
    ) -> None:
        """Gather what is asked.

        Args:
            poses: the dense contact state graph.
            reached: which postures reach which pose.
            queries: what counts as a collision in which step.
            holds: all grips and all pushes.
            settings: how finely to sample.
        """
        self.poses, self.reached, self.pair = poses, reached, reached.pair
        self.with_idle, self.opened, self.lifted = queries.with_idle, queries.opened, queries.lifted
        self._between = queries.beside
        self.grips, self.pushes = holds
        self.settings = settings or SweepSettings()
        self._along: dict[tuple[int, Hand, int, bool], int] = {}
        self._approach: dict[tuple[int, Hand, int], int] = {}
        self._together: dict[tuple[int, int, int, int, int], bool] = {}
        self._beside: dict[tuple[int, Hand, int, int, int, int], tuple[str, str] | None] = {}
        self._samples: dict[int, Array] = {}
        self._blocked: dict[int, tuple[str, str] | None] = {}

    def hand(self, hand: Hand) -> HandReach:
        """Return a hand's reach."""
        return self.reached.hand(hand)

    def motion(self, number: int) -> PlateMotion:
        """Return a motion of the graph, from its first to its second pose."""
        i, j = self.poses.edges[number]
        return self.poses.motion_between(int(i), int(j))

    def samples(self, number: int) -> Array:
        """Return T_world_plate (n, 4, 4) along a motion, close enough together to follow postures."""
        known = self._samples.get(number)
        if known is None:
            motion = self.motion(number)
            corners = self.poses.plate.shape.polyhedron.vertices
            coarse = motion.poses(np.linspace(0.0, 1.0, 9))
            world = np.einsum("nij,vj->nvi", coarse[:, :3, :3], corners) + coarse[:, None, :3, 3]
            way = float(np.linalg.norm(np.diff(world, axis=0), axis=2).sum(axis=0).max())
            known = motion.poses(np.linspace(0.0, 1.0, max(2, int(np.ceil(way / self.settings.plate_step))) + 1))
            self._samples[number] = known
        return known

    def along(self, number: int, hand: Hand, index: int, *, alone: bool) -> int:
        """Return the postures of a hold that follow a motion, the other arm idle (`alone`) or left aside."""
        key = (number, hand, index, alone)
        if key not in self._along:
            i, j = self.poses.edges[number]
            both = self.reached.at(hand, i, index) & self.reached.at(hand, j, index)
            query = self.with_idle[hand] if alone else self.hand(hand).alone
            self._along[key] = self.hand(hand).track(self.samples(number), index, both, query) if both else 0
        return self._along[key]

    def blocked(self, number: int) -> tuple[str, str] | None:
        """Name what the plate or its cup would meet along a motion, or None."""
        if number not in self._blocked:
            self._blocked[number] = next(self.lifted.meetings(self.samples(number)), None)
        return self._blocked[number]

    def approach(self, pose: int, hand: Hand, index: int) -> int:
        """Return the postures of a hold that can be come to, and left, on a straight way at a pose."""
        key = (pose, hand, index)
        if key not in self._approach:
            carriers = self.approach_carriers(self.poses.poses[pose].T_world_plate, hand, index)
            plates = np.repeat(self.poses.poses[pose].T_world_plate[None], len(carriers), axis=0)
            allowed = self.reached.at(hand, pose, index)
            self._approach[key] = self.hand(hand).track(plates, index, allowed, self.opened[hand], carriers)
        return self._approach[key]

    def approach_carriers(self, T_world_plate: Array, hand: Hand, index: int) -> Array:
        """Return (n, 4, 4) where the plate would be if it left with the hand: from contact to the stand-off."""
        settings = self.settings
        direction = -self.grips[index].approach if hand == "grip" else self.pushes[index].retreat
        way = settings.grip_approach if hand == "grip" else settings.push_approach
        steps = np.linspace(0.0, way, int(np.ceil(way / settings.approach_step)) + 1)
        carriers = np.repeat(T_world_plate[None], len(steps), axis=0)
        carriers[:, :3, 3] += steps[:, None] * (T_world_plate[:3, :3] @ direction)
        return carriers

    def together(self, number: int, grip: tuple[int, int], push: tuple[int, int]) -> bool:
        """Whether a grip and a push, each (index, posture), keep the arms apart along a motion."""
        key = (number, *grip, *push)
        if key not in self._together:
            found = self.pair.compatible(self.samples(number), (grip[0], push[0]), (1 << grip[1], 1 << push[1]))
            self._together[key] = found is not None
        return self._together[key]

    def beside(self, pose: int, coming: Hand, grip: tuple[int, int], push: tuple[int, int]) -> tuple[str, str] | None:
        """Name what of the arms would touch as a hand comes to the plate at a pose, or leaves it, beside the other one.

        Args:
            pose: of the plate, which stands still.
            coming: the hand that comes or leaves, on its straight way.
            grip: index and posture, which reaches the pose.
            push: the same.
        """
        key = (pose, coming, *grip, *push)
        if key not in self._beside:
            T_world_plate = self.poses.poses[pose].T_world_plate
            mine, others = (grip, push) if coming == "grip" else (push, grip)
            mover, other = self.hand(coming), self.hand("push" if coming == "grip" else "grip")
            q = np.zeros(12)
            q[other.joints] = other.follow(T_world_plate[None], *others)[0]
            way = mover.follow(self.approach_carriers(T_world_plate, coming, mine[0]), *mine)
            self._beside[key] = touching(self._between[coming], among_all(q, mover.joints, way))
        return self._beside[key]

    def together_at(self, pose: int, grip: tuple[int, int], push: tuple[int, int]) -> bool:
        """Whether a grip and a push, each (index, posture), keep the arms apart at a pose."""
        key = (-1 - pose, *grip, *push)
        if key not in self._together:
            where = self.poses.poses[pose].T_world_plate[None]
            found = self.pair.compatible(where, (grip[0], push[0]), (1 << grip[1], 1 << push[1]))
            self._together[key] = found is not None
        return self._together[key]
