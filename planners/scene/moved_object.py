"""An object that is to be moved, and all poses that count as its goal."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Literal

import numpy as np

from planners.geometry.pose import Array, Transform, inverse, rotation_x, rotation_z, transform
from planners.geometry.symmetry import rotations
from planners.scene.body import Body
from planners.scene.solid import ExtrudedSolid, Solid

Symmetry = Literal["none", "axis", "shape"]
AXIS_STEP = math.radians(15.0)
"""How finely the turns about an axis are sampled [rad]."""
GOAL_DISTANCE = 1e-3
"""An object this near to its goal is there [m]; contract."""
GOAL_ANGLE = math.radians(0.5)
"""The same for its orientation [rad]; contract."""
SAME_PLACE = 1e-6
"""Corners closer together than this are one corner; a turn is a symmetry of the shape if it takes every corner to
within ten times this of a corner [m]."""


@dataclass(frozen=True, eq=False)
class MovedObject:
    """An object with its goal; `T_world_goal @ turn` is as good, for every one of its turns."""

    body: Body
    T_world_goal: Transform
    symmetry: Symmetry
    goal_turns: Array
    """(k, 4, 4), the first one the identity; turns about an axis are sampled every 15 degrees. Only those after which
    it rests."""
    start_supports: tuple[str, ...]
    """What carries it at the start: names of bodies, "table" among them."""
    goal_supports: tuple[str, ...]
    """What carries it at its goal: names of bodies; an object that is named is meant at its own goal, and has to be
    there first."""
    T_world_start_given: Transform
    T_world_goal_given: Transform
    """As the task gives them, before they were settled onto what carries the object."""

    @property
    def name(self) -> str:
        """The name of its body."""
        return self.body.name

    def to(self, poses: Sequence[Transform]) -> MovedObject:
        """Return the object with other goals, the first of them the goal; nothing is said of what carries it there."""
        back = inverse(poses[0])
        turns = np.array([back @ T for T in poses])
        return replace(self, T_world_goal=poses[0], symmetry="none", goal_turns=turns, goal_supports=())

    @property
    def side(self) -> float:
        """1 to the robot's left, -1 to its right, see `side_of`."""
        return side_of(np.vstack([self.body.T_world_body[None], self.goals]), self.body.com)

    @property
    def goals(self) -> Array:
        """(k, 4, 4) `T_world_object` of every goal."""
        return self.T_world_goal @ self.goal_turns

    @property
    def turns_freely(self) -> bool:
        """Whether the goal tells no turns about the body's z axis apart, of which `goal_turns` are a sample."""
        round_ = isinstance(self.body.solid, ExtrudedSolid) and self.body.solid.is_round
        return self.symmetry == "axis" or (self.symmetry == "shape" and round_)

    def off_goal(self, T_world_object: Transform) -> float:
        """Return how far a pose is from the goal as it is given, or the nearest of all its turns.

        Returns:
            The larger of distance and angle, as shares of what the contract allows [1]: at the goal up to 1. Turns
            about an axis are not sampled here; the object need not rest after the turn.
        """
        T_goal_object = inverse(self.T_world_goal_given) @ T_world_object
        if self.turns_freely:
            upright = T_goal_object[2, 2] if self.symmetry == "axis" else abs(T_goal_object[2, 2])
            angle = math.atan2(math.hypot(T_goal_object[0, 2], T_goal_object[1, 2]), upright)
            return max(float(np.linalg.norm(T_goal_object[:3, 3])) / GOAL_DISTANCE, angle / GOAL_ANGLE)
        turns = self._symmetry_turns
        distances = np.linalg.norm(T_goal_object[:3, 3] - turns[:, :3, 3], axis=1)
        chords = np.linalg.norm(T_goal_object[:3, :3] - turns[:, :3, :3], axis=(1, 2)) / math.sqrt(2.0)
        angles = 2.0 * np.arcsin(np.minimum(1.0, chords / 2.0))
        return float(np.maximum(distances / GOAL_DISTANCE, angles / GOAL_ANGLE).min())

    @cached_property
    def _symmetry_turns(self) -> Array:
        return symmetry_turns(self.body.solid, self.symmetry)


def side_of(T_world_bodies: Array, point: Array) -> float:
    """Return 1 to the robot's left, -1 to its right: the cell's left and right are mirror images of one another.

    What is tried in an order that is turned over with it comes in mirrored order for a mirrored task.

    Args:
        T_world_bodies: (k, 4, 4) where a body is and where it goes; the first that is not in the middle decides.
        point: (3,) of the body [m].
    """
    beside = T_world_bodies[:, 1, :3] @ point + T_world_bodies[:, 1, 3]
    return next((math.copysign(1.0, y) for y in beside.tolist() if abs(y) > SAME_PLACE), 1.0)


@lru_cache(maxsize=64)
def symmetry_turns(solid: Solid, symmetry: Symmetry) -> Array:
    """Return the turns (k, 4, 4) of a body that its goal does not tell apart, the identity first.

    Args:
        solid: of the body.
        symmetry: "axis" is any turn about the body's z axis; "shape" every turn that takes the shape to itself.
    """
    if symmetry == "none":
        return np.eye(4)[None]
    if symmetry == "axis":
        return _axis_turns()
    if isinstance(solid, ExtrudedSolid) and solid.is_round:
        return np.vstack([_axis_turns(), _axis_turns() @ transform(rotation_x(math.pi))])
    corners = np.vstack([face.corners for face in solid.flat_faces()])
    corners = np.unique(np.round(corners / SAME_PLACE), axis=0) * SAME_PLACE
    center = corners.mean(axis=0)
    turns = [transform(R, center - R @ center) for R in rotations(corners, 10.0 * SAME_PLACE)]
    return np.array(turns)


def _axis_turns() -> Array:
    steps = round(2.0 * math.pi / AXIS_STEP)
    return np.array([transform(rotation_z(k * AXIS_STEP)) for k in range(steps)])
