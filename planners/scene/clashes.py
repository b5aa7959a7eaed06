"""Bodies that overlap at the start."""

from __future__ import annotations

from collections.abc import Container, Sequence
from dataclasses import dataclass

import numpy as np

from planners.collision.distance import distance
from planners.errors import SceneError
from planners.geometry.convex import CollisionBody, ConvexShape
from planners.geometry.pose import Array
from planners.kinematics.forward import link_frames
from planners.scene.cell import Cell

_IDENTITY = np.eye(4)


class BodiesOverlap(SceneError):
    """Two bodies touch or overlap at the start; every member of the task that places one of them is pointed at."""

    def __init__(self, a: PlacedBody, b: PlacedBody) -> None:
        self.pointers = tuple(dict.fromkeys(body.pointer for body in (a, b) if body.pointer is not None))
        super().__init__(self.pointers[0], f"{a.name} and {b.name} touch or overlap at the start")


@dataclass(frozen=True, eq=False)
class PlacedBody:
    """A body with its shapes in the world."""

    name: str
    pointer: str | None
    """The member of the task that says where it is; None for what belongs to the cell."""
    shapes: tuple[ConvexShape, ...]
    """In the world."""
    lowest: Array
    """(3,) lower corner of the box around it [m]."""
    highest: Array
    """(3,) upper corner of the box around it [m]."""


def placed_body(body: CollisionBody, T_world_frame: Array, pointer: str | None) -> PlacedBody:
    """Take a body from its frame to the world."""
    R, p = T_world_frame[:3, :3], T_world_frame[:3, 3]
    shapes = tuple(ConvexShape(shape.vertices @ R.T + p, shape.radius) for shape in body.shapes)
    lowest = np.min([shape.vertices.min(axis=0) - shape.radius for shape in shapes], axis=0)
    highest = np.max([shape.vertices.max(axis=0) + shape.radius for shape in shapes], axis=0)
    return PlacedBody(body.name, pointer, shapes, lowest, highest)


def placed_arms(cell: Cell, positions: Array, widths: dict[str, float]) -> list[PlacedBody]:
    """Place the bodies of both arms and hands at joint `positions` (12,) [rad] and finger openings `widths` [m]."""
    frames = {"world": _IDENTITY}
    for arm, q in zip(("left", "right"), (positions[:6], positions[6:]), strict=True):
        poses = np.empty((7, 4, 4))
        link_frames(cell.arms[arm].dh, cell.arms[arm].T_world_base, np.ascontiguousarray(q), poses)
        frames |= {f"{arm}/{i}": poses[i] for i in range(7)}
    moving = (body for body in cell.collision_bodies(widths) if body.frame != "world")
    return [placed_body(body, frames[body.frame], "/start_positions") for body in moving]


def refuse_overlaps(
    group: Sequence[PlacedBody], others: Sequence[PlacedBody], allowed: Container[tuple[str, str]] = ()
) -> None:
    """Check every body of one group against every body of another.

    Args:
        group: Bodies.
        others: Bodies; may be the same list, then each pair is met once.
        allowed: Sorted pairs of names that may touch.

    Raises:
        BodiesOverlap: for the first pair, in the order given, that touches or overlaps.
    """
    if not group or not others:
        return
    low, high = np.array([b.lowest for b in group]), np.array([b.highest for b in group])
    other_low, other_high = np.array([b.lowest for b in others]), np.array([b.highest for b in others])
    near = np.all((low[:, None] <= other_high[None]) & (other_low[None] <= high[:, None]), axis=2)
    if group is others:
        near = np.triu(near, k=1)
    for i, j in np.argwhere(near):
        a, b = group[i], others[j]
        if (min(a.name, b.name), max(a.name, b.name)) not in allowed and _overlap(a, b):
            raise BodiesOverlap(a, b)


def _overlap(a: PlacedBody, b: PlacedBody) -> bool:
    return any(distance(s, _IDENTITY, t, _IDENTITY) <= 0.0 for s in a.shapes for t in b.shapes)
