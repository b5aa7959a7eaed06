"""Where a thing comes to lie that somebody moves: at whole millimetres and degrees, at rest on what is below."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import ConvexHull

from app.viewer.editor.draft import PLATE, SUPPORT, TOOL_POSE, Draft, DraftPart
from planners.cell.cell import Cell
from planners.geometry import polygon
from planners.geometry.pose import Array, Transform, rotation_z, to_pose7, transform
from planners.scene.placements import box_top
from planners.scene.rest import SMALLEST_OVERLAP, LevelFace, face_tilt, level_places, lowest_face, settled
from planners.scene.solid import Solid

STEP = 1e-3
"""Of the grid that dragged things keep to [m]."""
TURN_STEP = math.radians(1.0)
"""[rad]"""
TIPPED = math.radians(60.0)
"""A body that is tilted more than this is on no face that it could be put down on by turning it level [rad]."""
CLEAR = 1e-6
"""Bodies whose heights share no more than this are above one another [m]."""
POSE_DIGITS = 9


@dataclass(frozen=True, eq=False)
class Column:
    """What a body takes up, seen from above, and the level places on it."""

    outline: Array
    """(n, 2) of its hull, counter-clockwise [m]."""
    bottom: float
    top: float
    places: tuple[LevelFace, ...]

    @classmethod
    def of(cls, name: str, solid: Solid, T_world_body: Transform) -> Column:
        """Return the column of a body at its pose (4, 4)."""
        corners = solid.surface()[0] @ T_world_body[:3, :3].T + T_world_body[:3, 3]
        outline = corners[ConvexHull(corners[:, :2]).vertices, :2]
        heights = corners[:, 2]
        return cls(outline, heights.min(), heights.max(), tuple(level_places(name, solid, T_world_body)))


def put(part: DraftPart, T_wanted: Transform, draft: Draft, cell: Cell) -> Transform:
    """Return where a thing comes to lie that is wanted somewhere.

    Place and yaw are rounded. What has to rest is put down on the lowest level place below it where there is room for
    it; so an object that is moved over another one comes to lie on top of it, and one under a roof stays there.

    Args:
        part: the thing.
        T_wanted: where its body frame is wanted in the world; of what rests, the height does not matter.
        draft: all things.
        cell: with what stands in it.
    """
    T = transform(_on_grid(T_wanted[:3, :3]), np.append(np.round(T_wanted[:2, 3] / STEP) * STEP, T_wanted[2, 3]))
    if not part.rests:
        return T
    face = lowest_face(part.solid, T)
    if face_tilt(face, T) > TIPPED:
        return T
    around = [
        *_own_columns(cell),
        *(Column.of(each.name, each.solid, each.T_world_body) for each in _others(part, draft)),
    ]
    own = Column.of(part.name, part.solid, settled(face, T, 0.0))
    near = [column for column in around if _overlap(own.outline, column.outline)]
    for height in sorted({place.height for column in near for place in _carrying(column, part, own)}):
        if all(height + own.top <= column.bottom + CLEAR or height >= column.top - CLEAR for column in near):
            return settled(face, T, height)
    return settled(face, T, cell.table_top)


def written(T_world_body: Transform) -> list[float]:
    """Return a pose as the task states it, without digits that nobody means."""
    return [round(value, POSE_DIGITS) + 0.0 for value in to_pose7(T_world_body)]


def yaw_of(rotation: Array) -> float:
    """Return the turn about the vertical of a rotation (3, 3): of its x axis, or of y where x is upright [rad]."""
    if abs(rotation[2, 0]) < math.cos(math.radians(30.0)):
        return math.atan2(rotation[1, 0], rotation[0, 0])
    return math.atan2(-rotation[0, 1], rotation[1, 1])


def _on_grid(rotation: Array) -> Array:
    yaw = yaw_of(rotation)
    return rotation_z(round(yaw / TURN_STEP) * TURN_STEP - yaw) @ rotation


def _own_columns(cell: Cell) -> Iterable[Column]:
    """Yield the table and what stands as high; below the table nothing is put."""
    for place, box in ((box_top(box), box) for box in cell.boxes):
        if place.height < cell.table_top:
            continue
        yield Column(place.outline, float(box.center[2] - 0.5 * box.size[2]), place.height, (place,))


def _others(part: DraftPart, draft: Draft) -> Sequence[DraftPart]:
    """Return what stands still while a thing is moved: at the start what is there then, at the goals what is there."""
    return [
        each
        for each in draft.parts.values()
        if each is not part and each.pointer != TOOL_POSE and (each.role != "object" or each.is_goal == part.is_goal)
    ]


def _carrying(column: Column, part: DraftPart, own: Column) -> Iterable[LevelFace]:
    """Yield the places of a column that may carry a thing: a plate lies on table or support, a support on the table."""
    for place in column.places:
        fits = {PLATE: ("table", "support"), SUPPORT: ("table",)}.get(part.pointer)
        if (fits is None or place.name in fits) and _overlap(own.outline, place.outline):
            yield place


def _overlap(one: Array, other: Array) -> bool:
    if np.any(one.max(axis=0) < other.min(axis=0)) or np.any(other.max(axis=0) < one.min(axis=0)):
        return False
    shared = polygon.overlap(one, other)
    return len(shared) > 2 and polygon.area(shared) > SMALLEST_OVERLAP
