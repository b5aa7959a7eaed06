"""An object that is to be moved, and all poses that count as its goal."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from planners.geometry.pose import Array, Transform, inverse, rotation_x, rotation_z, transform
from planners.geometry.symmetry import rotations
from planners.scene.body import Body
from planners.scene.solid import ExtrudedSolid, Solid

Symmetry = Literal["none", "axis", "shape"]
AXIS_STEP = math.radians(15.0)
"""How finely the turns about an axis are sampled [rad]."""
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
    def goals(self) -> Array:
        """(k, 4, 4) `T_world_object` of every goal."""
        return self.T_world_goal @ self.goal_turns


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
