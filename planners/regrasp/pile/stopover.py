"""Stopovers: free places where an object rests for a while on the way to its goal.

It stands there because another one has to go where it is, or because the cup cannot take it to its goal in one go: a
cup only pulls, so that a facet must not look down at either end. Resting on another of its faces, it shows the cup
others.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.spatial import ConvexHull

from planners.geometry.convex import ConvexShape
from planners.geometry.pose import Array, Transform, rotation_from_vector, rotation_z, transform
from planners.regrasp.tool_settings import StopoverSettings
from planners.scene.body import Body
from planners.scene.clashes import PlacedBody, first_overlap, placed_body
from planners.scene.moved_object import MovedObject
from planners.scene.rest import Footing, LevelFace, find_footing, lies_in_plane, lowest_face
from planners.scene.solid import FlatFace
from planners.scene.tool_placements import StillBodies

_SAME_NORMAL = 1.0 - 1e-9
"""Cosine of the angle between normals that are one."""


@dataclass(frozen=True, eq=False)
class Stopovers:
    """Finds places on what never moves, clear of where all objects are and of where they are to go."""

    still: StillBodies
    settings: StopoverSettings = field(default_factory=StopoverSettings)

    def targets(self, moved: MovedObject, others: Sequence[tuple[Body, Transform]]) -> Iterator[MovedObject]:
        """Yield the object with free places as its goals: as upright as it stands first, then on its other faces.

        Args:
            moved: the object where it stands now.
            others: the other movable bodies, each where it stands, and once more where it is to go.
        """
        body, settings = moved.body, self.settings
        here = body.T_world_body
        occupied = [placed_body(other.collision_body(), T, None) for other, T in others]
        # Turned and listed the other way round on the robot's other side: mirrored tasks have mirrored stopovers.
        side = moved.side
        upright = [rotation_z(side * k * math.pi / settings.turns) @ here[:3, :3] for k in range(settings.turns)]

        def from_here(point: Sequence[float]) -> Sequence[float]:
            return (math.dist(point, here[:3, 3]), point[0], side * point[1])

        def on_the_way(point: Sequence[float]) -> Sequence[float]:
            return (_detour(point, moved), point[0], side * point[1])

        near = self._goals(body, upright, from_here, occupied, settings.most)
        if near:
            yield moved.to(near)
        for face in self._other_faces(body, side):
            step = side * 2.0 * math.pi / settings.turns_on_others
            laid = _laid_on(face, here[:3, :3])
            turned = [rotation_z(k * step) @ laid for k in range(settings.turns_on_others)]
            between = self._goals(body, turned, on_the_way, occupied, settings.most_on_others)
            if between:
                yield moved.to(between)

    def _other_faces(self, body: Body, side: float) -> list[FlatFace]:
        """Return the faces on which a body would rest steadily but for the one it rests on, the steadiest first.

        Of those that are as steady, the one that looks back comes first, then the one towards the robot's middle.
        """
        own = lowest_face(body.solid, body.T_world_body).normal
        steadiness = [
            (steadiness_on(standing, body.com), face)
            for face in body.solid.flat_faces()
            if face.normal @ own < _SAME_NORMAL and (standing := _standing_on(body, face)) is not None
        ]
        looks = [1.0, side, 1.0] * body.T_world_body[:3, :3].T
        steadiness.sort(key=lambda entry: (-round(entry[0], 6), *np.round(entry[1].normal @ looks, 6)))
        return [face for angle, face in steadiness if angle >= self.settings.steady][: self.settings.faces]

    def _goals(
        self,
        body: Body,
        turned: Sequence[Array],
        order: Callable[[Sequence[float]], Sequence[float]],
        occupied: Sequence[PlacedBody],
        most: int,
    ) -> list[Transform]:
        """Return free poses in these orientations (3, 3), in the order of their places."""
        for clearance in self.settings.clearances:
            goals: list[Transform] = []
            for footing in self._footings(body, turned, order):
                around = [*occupied, *(each for each in self.still.bodies if each.name not in footing.supports)]
                grown = _grown(placed_body(body.collision_body(), footing.T_world_body, None), clearance)
                if first_overlap([grown], around) is None:
                    goals.append(footing.T_world_body)
                if len(goals) == most:
                    break
            if goals:
                return goals
        return []

    def _footings(
        self, body: Body, turned: Sequence[Array], order: Callable[[Sequence[float]], Sequence[float]]
    ) -> Iterator[Footing]:
        """Yield where the object rests in these orientations (3, 3), place by place."""
        lowest = float((body.solid.surface()[0] @ turned[0][2]).min())
        points = [(*point, place.height - lowest) for place in self.still.places for point in self._grid(place)]
        points.sort(key=lambda point: [round(value, 6) for value in order(point)])
        for point in points:
            for R in turned:
                footing = find_footing(body.solid, transform(R, point), body.com, self.still.places)
                if isinstance(footing, Footing):
                    yield footing

    def _grid(self, place: LevelFace) -> Iterator[tuple[float, float]]:
        low, high = place.outline.min(axis=0), place.outline.max(axis=0)
        # About the middle, so that places on either side of the robot are mirror images.
        counts = np.floor(0.5 * (high - low) / self.settings.spacing).astype(int)
        middle, steps = 0.5 * (low + high), [np.arange(-count, count + 1) for count in counts]
        x, y = (each + self.settings.spacing * step for each, step in zip(middle, steps, strict=True))
        yield from ((float(a), float(b)) for a in x for b in y)


def _standing_on(body: Body, face: FlatFace) -> FlatFace | None:
    """Return the hull of the flat places of a body that lie in one of its hull's faces; None where there are none."""
    corners = [
        piece.corners
        for piece in body.solid.flat_pieces()
        if piece.normal @ face.normal > _SAME_NORMAL and lies_in_plane(piece, face)
    ]
    if not corners:
        return None
    points = np.vstack(corners)
    across = face.corners[1] - face.corners[0]
    across /= np.linalg.norm(across)
    plane = np.column_stack([points @ across, points @ np.cross(face.normal, across)])
    return FlatFace(face.normal, points[ConvexHull(plane).vertices])


def _laid_on(face: FlatFace, R_world_body: Array) -> Array:
    """Return the orientation (3, 3) of a body once a face of it is turned down, the shortest way."""
    normal = R_world_body @ face.normal
    across = np.array([normal[1], -normal[0], 0.0])
    sine = float(np.linalg.norm(across))
    axis = across / sine if sine > 0.0 else np.array([1.0, 0.0, 0.0])
    return rotation_from_vector(-math.atan2(sine, -normal[2]) * axis) @ R_world_body


def steadiness_on(face: FlatFace, com: Array) -> float:
    """Return the tilt at which a body topples over an edge of a face it rests on; negative where it topples [rad].

    Args:
        face: convex.
        com: (3,) centre of mass, in the same frame [m].
    """
    ends = np.roll(face.corners, -1, axis=0)
    inward = np.cross(face.normal, ends - face.corners)
    inward /= np.linalg.norm(inward, axis=1, keepdims=True)
    inside = float(np.einsum("ij,ij->i", com - face.corners, inward).min())
    height = float((face.corners[0] - com) @ face.normal)
    return math.atan2(inside, height)


def _detour(point: Sequence[float], moved: MovedObject) -> float:
    """Return how long the way from where an object is to a point and on to its goal is [m]."""
    return math.dist(point, moved.body.T_world_body[:3, 3]) + math.dist(point, moved.T_world_goal[:3, 3])


def _grown(body: PlacedBody, clearance: float) -> PlacedBody:
    shapes = tuple(ConvexShape(shape.vertices, shape.radius + clearance) for shape in body.shapes)
    return replace(body, shapes=shapes, lowest=body.lowest - clearance, highest=body.highest + clearance)
