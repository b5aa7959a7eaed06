"""How far an object is from its goal, whichever of its equivalent poses is nearest."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planners.geometry.pose import Transform, rotation_angle
from planners.scene.moved_object import MovedObject
from planners.scene.solid import ExtrudedSolid


@dataclass(frozen=True)
class GoalError:
    """Distance [m] and angle [rad]."""

    distance: float
    angle: float

    @classmethod
    def of(cls, moved: MovedObject, T_world_object: Transform) -> GoalError:
        """Compare; where any turn about the object's axis is as good, turns about it do not count."""
        distances = np.linalg.norm(moved.goals[:, :3, 3] - T_world_object[:3, 3], axis=1)
        if _any_turn(moved):
            angles = np.arccos(np.clip(moved.goals[:, :3, 2] @ T_world_object[:3, 2], -1.0, 1.0))
        else:
            angles = np.array([rotation_angle(goal[:3, :3], T_world_object[:3, :3]) for goal in moved.goals])
        # A turn that moves the origin counts by both.
        best = int(np.argmin(distances + 0.1 * angles))
        return cls(float(distances[best]), float(angles[best]))


def _any_turn(moved: MovedObject) -> bool:
    solid = moved.body.solid
    round_ = isinstance(solid, ExtrudedSolid) and solid.is_round
    return moved.symmetry == "axis" or (moved.symmetry == "shape" and round_)
