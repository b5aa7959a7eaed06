"""Which object is moved when: nearest to its goal first, but supports before what lies on them."""

from __future__ import annotations

from collections.abc import Mapping, Set
from dataclasses import dataclass
from itertools import permutations

import numpy as np

from planners.geometry.pose import Transform
from planners.regrasp.resting import resting_points
from planners.scene.clashes import PlacedBody, gap, placed_body
from planners.scene.moved_object import MovedObject

CONTACT = 1e-6
"""Bodies that are no farther apart touch: what rests on another does so to rounding [m]."""


@dataclass(frozen=True)
class ObjectOrder:
    """What has to be moved before what, and how far each object has to go."""

    distances: Mapping[str, float]
    """From start to goal, between the origins of the objects [m]."""
    before: Mapping[str, frozenset[str]]
    """By object: those that must have been moved before it."""

    @classmethod
    def of(cls, objects: tuple[MovedObject, ...]) -> ObjectOrder:
        """Find out from starts and goals.

        One object goes before another if the other's goal rests on the one's, if the one lies on the other at the
        start, or if the one stands where the other is to go.
        """
        distances = {
            each.name: float(np.linalg.norm(each.T_world_goal[:3, 3] - each.body.T_world_body[:3, 3]))
            for each in objects
        }
        starts = {each.name: _placed(each, each.body.T_world_body) for each in objects}
        goals = {each.name: _placed(each, each.T_world_goal) for each in objects}
        before: dict[str, set[str]] = {each.name: set() for each in objects}
        for one, other in permutations(objects, 2):
            if _rests_on(other, other.T_world_goal, one, one.T_world_goal):
                before[other.name].add(one.name)
            if _rests_on(one, one.body.T_world_body, other, other.body.T_world_body):
                before[other.name].add(one.name)
            if _overlap(goals[other.name], starts[one.name]):
                before[other.name].add(one.name)
        return cls(distances, {name: frozenset(names) for name, names in before.items()})

    def next(self, moved: Set[str]) -> tuple[str, ...]:
        """Return the objects that can be moved next, nearest to its goal first, then by name."""
        waiting = (name for name in self.distances if name not in moved and self.before[name] <= moved)
        return tuple(sorted(waiting, key=lambda name: (self.distances[name], name)))


def _placed(each: MovedObject, T_world_object: Transform) -> PlacedBody:
    return placed_body(each.body.collision_body(), T_world_object, None)


def _overlap(one: PlacedBody, other: PlacedBody) -> bool:
    """Tell whether two bodies share room; side by side or on top of one another is apart."""
    low = np.maximum(one.lowest, other.lowest)
    high = np.minimum(one.highest, other.highest)
    return bool(np.all(high - low > CONTACT)) and gap(one, other) <= CONTACT


def _rests_on(upper: MovedObject, T_world_upper: Transform, lower: MovedObject, T_world_lower: Transform) -> bool:
    """Tell whether a level face of one body stands on a level face of another."""
    below = {lower.name: (lower.body.solid.flat_pieces(), T_world_lower)}
    return bool(len(resting_points(upper.body.solid.flat_pieces(), T_world_upper, below).points))
