"""Which object is moved when: nearest to its goal first, but supports before what lies on them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence, Set
from dataclasses import dataclass
from itertools import permutations

import numpy as np

from planners.geometry.pose import Transform
from planners.graph.rejections import Rejection
from planners.regrasp.statics.resting import resting_points
from planners.scene.clashes import PlacedBody, depth, gap, placed_body
from planners.scene.moved_object import MovedObject
from planners.scene.rest import REST_GAP

CONTACT = 1e-6
"""Bodies that are no deeper in one another touch: what rests on another does so to rounding [m]."""
_NEAR = 2.0 * REST_GAP
"""Bodies that are farther apart do not rest on one another [m]."""


@dataclass(frozen=True)
class ObjectOrder:
    """What has to be moved before what, and how far each object has to go. Names of objects, by name of an object."""

    distances: Mapping[str, float]
    """From start to goal, between the origins of the objects [m]."""
    carried: Mapping[str, frozenset[str]]
    """Those on which its goal rests."""
    lying_on_it: Mapping[str, frozenset[str]]
    """Those that lie on it at the start."""
    in_its_way: Mapping[str, frozenset[str]]
    """Those that stand where it is to go."""

    @classmethod
    def of(cls, objects: Sequence[MovedObject]) -> ObjectOrder:
        """Find out from starts and goals."""
        distances = {
            each.name: float(np.linalg.norm(each.T_world_goal[:3, 3] - each.body.T_world_body[:3, 3]))
            for each in objects
        }
        starts = {each.name: _placed(each, each.body.T_world_body) for each in objects}
        goals = {each.name: _placed(each, each.T_world_goal) for each in objects}
        carried, lying, standing = ({name: set[str]() for name in distances} for _ in range(3))
        for one, other in permutations(objects, 2):
            if _may_rest_on(goals[other.name], goals[one.name]) and _rests_on(
                other, other.T_world_goal, one, one.T_world_goal
            ):
                carried[other.name].add(one.name)
            if _may_rest_on(starts[one.name], starts[other.name]) and _rests_on(
                one, one.body.T_world_body, other, other.body.T_world_body
            ):
                lying[other.name].add(one.name)
            if _overlap(goals[other.name], starts[one.name]):
                standing[other.name].add(one.name)
        return cls(distances, _frozen(carried), _frozen(lying), _frozen(standing))

    def next(self, moved: Set[str]) -> tuple[str, ...]:
        """Return the objects that can be moved next, nearest to its goal first, then by name.

        One goes before another if the other's goal rests on the one's, if the one lies on the other, or if the one
        stands where the other is to go.
        """
        return self._sorted(name for name in self.waiting(moved) if self.before(name) <= moved)

    def next_aside(self, moved: Set[str]) -> tuple[str, ...]:
        """Return the objects that can be put aside, on which nothing lies.

        Those first that cannot go to their goals yet and hold another one up: they stand where it is to go, or lie on
        it. The others may still be too close to another one for the hands.
        """
        waiting = self.waiting(moved)
        held_up = set[str]().union(*((self.in_its_way[name] | self.lying_on_it[name]) - {name} for name in waiting))
        free = [name for name in self._sorted(waiting) if self.lying_on_it[name] <= moved]
        first = [name for name in free if name in held_up and not self.before(name) <= moved]
        return (*first, *(name for name in free if name not in first))

    def deadlock(self, moved: Set[str]) -> tuple[Rejection, ...]:
        """Say of each object that waits which others hold it up, and how."""
        rejections = []
        for name in self._sorted(self.waiting(moved)):
            for held_up, how in (
                (self.in_its_way, "stands where it is to go"),
                (self.lying_on_it, "lies on it"),
                (self.carried, "is to carry it and is not at its goal"),
            ):
                for other in sorted(held_up[name] - moved):
                    rejections.append(Rejection("order", f"{name} has to wait: {other} {how}", name))
        return tuple(rejections)

    def waiting(self, moved: Set[str]) -> set[str]:
        """Return the objects that are not moved yet."""
        return set(self.distances) - moved

    def before(self, name: str) -> frozenset[str]:
        """Return those that must have been moved before an object."""
        return self.carried[name] | self.lying_on_it[name] | self.in_its_way[name]

    def _sorted(self, names: Iterable[str]) -> tuple[str, ...]:
        return tuple(sorted(names, key=lambda name: (self.distances[name], name)))


def _frozen(sets: Mapping[str, set[str]]) -> dict[str, frozenset[str]]:
    return {name: frozenset(names) for name, names in sets.items()}


def _placed(each: MovedObject, T_world_object: Transform) -> PlacedBody:
    return placed_body(each.body.collision_body(), T_world_object, None)


def _may_rest_on(upper: PlacedBody, lower: PlacedBody) -> bool:
    """Tell whether boxes around two bodies come near one another, and the lower one's reaches farther down.

    Where it does not, it may be a thin body whose top is as near to the other's bottom because it lies on that.
    """
    low = np.maximum(upper.lowest, lower.lowest)
    high = np.minimum(upper.highest, lower.highest)
    return bool(np.all(low - high <= _NEAR)) and bool(lower.lowest[2] < upper.lowest[2])


def _overlap(one: PlacedBody, other: PlacedBody) -> bool:
    """Tell whether two bodies share room; side by side or on top of one another is apart."""
    low = np.maximum(one.lowest, other.lowest)
    high = np.minimum(one.highest, other.highest)
    # Boxes around turned bodies overlap before these do, and those that touch are apart by nothing.
    return bool(np.all(high - low > CONTACT)) and gap(one, other) <= 0.0 and depth(one, other) > CONTACT


def _rests_on(upper: MovedObject, T_world_upper: Transform, lower: MovedObject, T_world_lower: Transform) -> bool:
    """Tell whether a level face of one body stands on a level face of another."""
    below = {lower.name: (lower.body.solid.flat_pieces(), T_world_lower)}
    return bool(len(resting_points(upper.body.solid.flat_pieces(), T_world_upper, below).points))
