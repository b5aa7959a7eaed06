"""Free places where an object can stand for a while, because another one has to go where it is."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from planners.geometry.convex import ConvexShape
from planners.geometry.pose import Transform, inverse, rotation_z, transform
from planners.scene.body import Body
from planners.scene.clashes import PlacedBody, first_overlap, placed_body
from planners.scene.footing import Footing, find_footing
from planners.scene.moved_object import MovedObject
from planners.scene.rest import Surface
from planners.scene.tool_placements import StillBodies


@dataclass(frozen=True)
class SetAsideSettings:
    """Which places are looked at. All of it is our choice."""

    spacing: float = 0.05
    """Of the places on a level face [m]."""
    turns: int = 2
    """Turns of the object about the vertical, evenly around half a turn, from how it stands."""
    clearances: tuple[float, ...] = (0.06, 0.02)
    """Room on all sides to everything that stands or is to stand there [m]; the next where there are no places with
    the one before."""
    most: int = 8
    """Places offered as goals, the nearest."""


@dataclass(frozen=True, eq=False)
class SetAside:
    """Finds places on what never moves, clear of where all objects are and of where they are to go."""

    still: StillBodies
    settings: SetAsideSettings = SetAsideSettings()

    def target(self, moved: MovedObject, others: Sequence[tuple[Body, Transform]]) -> MovedObject | None:
        """Return the object with free places as its goals, the nearest first; None where there are none.

        Args:
            moved: the object where it stands now.
            others: the other movable bodies, each where it stands, and once more where it is to go.
        """
        body = moved.body
        occupied = [placed_body(other.collision_body(), T, None) for other, T in others]
        for clearance in self.settings.clearances:
            goals: list[Transform] = []
            for footing in self._footings(body):
                around = self._others(occupied, footing)
                grown = _grown(placed_body(body.collision_body(), footing.T_world_body, None), clearance)
                if first_overlap([grown], around) is None:
                    goals.append(footing.T_world_body)
                if len(goals) == self.settings.most:
                    break
            if goals:
                back = inverse(goals[0])
                turns = np.array([back @ T for T in goals])
                return replace(moved, T_world_goal=goals[0], symmetry="none", goal_turns=turns, goal_supports=())
        return None

    def _others(self, occupied: Sequence[PlacedBody], footing: Footing) -> list[PlacedBody]:
        return [*occupied, *(body for body in self.still.bodies if body.name not in footing.supports)]

    def _footings(self, body: Body) -> Iterator[Footing]:
        """Yield where the object rests, as upright as it stands now, the nearest first."""
        here = body.T_world_body
        lowest = float((body.solid.surface()[0] @ here[2, :3]).min())
        points = [
            np.array([*point, place.height - lowest]) for place in self.still.places for point in self._grid(place)
        ]
        points.sort(key=lambda point: round(math.dist(point, here[:3, 3]), 6))
        step = math.pi / self.settings.turns
        for point in points:
            for turn in range(self.settings.turns):
                T = transform(rotation_z(turn * step) @ here[:3, :3], point)
                footing = find_footing(body.solid, T, body.com, self.still.places)
                if isinstance(footing, Footing):
                    yield footing

    def _grid(self, place: Surface) -> Iterator[tuple[float, float]]:
        low, high = place.outline.min(axis=0), place.outline.max(axis=0)
        x, y = (np.arange(a, b, self.settings.spacing) for a, b in zip(low, high, strict=True))
        yield from ((float(a), float(b)) for a in x for b in y)


def _grown(body: PlacedBody, clearance: float) -> PlacedBody:
    shapes = tuple(ConvexShape(shape.vertices, shape.radius + clearance) for shape in body.shapes)
    return replace(body, shapes=shapes, lowest=body.lowest - clearance, highest=body.highest + clearance)
