"""Putting the bodies of a plate lift where its task says, at rest on what carries them."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from scipy.spatial import ConvexHull

from planners.contract.shapes import Mesh
from planners.contract.task_spec import Obstacle, PlateLiftTask, Support
from planners.errors import SceneError
from planners.geometry import polygon
from planners.geometry.pose import Array, from_pose7
from planners.scene.body import Body, Plate
from planners.scene.cell import Cell
from planners.scene.rest import (
    REST_GAP,
    REST_TILT,
    Surface,
    face_tilt,
    footprint,
    gaps,
    lowest_face,
    overhang,
    rests_level,
    scalar_last_hint,
    settled,
    upper_surface,
)
from planners.scene.shape_source import ShapeSource
from planners.scene.solid import solid_of

SUPPORT_SHAPES = ("box", "cylinder", "prism")
"""The types of shapes that a plate may lie on."""
CONTAINMENT_SLACK = 1e-9
"""Rounding allowed where a point must lie inside a body [m]."""


def table_surface(cell: Cell) -> Surface:
    """Return the top of the cell's table."""
    (table,) = (body for body in cell.bodies if body.name == "table")
    corners = np.vstack([shape.vertices for shape in table.shapes])
    top = corners[np.abs(corners[:, 2] - cell.table_top) < 1e-6, :2]
    return Surface("table", cell.table_top, top[ConvexHull(top).vertices])


def place_support(support: Support, table: Surface, shapes: ShapeSource) -> Body:
    """Settle the support on the table; its centre must be over it, or it would tip."""
    if isinstance(support.shape, Mesh):
        detail = "plates are not lifted off meshes yet"
        raise SceneError("/support/shape/type", detail, list(SUPPORT_SHAPES))
    stated, solid = shapes.find(support.shape, "/support/shape")
    body = Body("support", "support", stated, solid, None, np.zeros(3), from_pose7(support.pose), static=True)
    face = lowest_face(body.solid, body.T_world_body)
    if not rests_level(face, body.T_world_body, table.height):
        raise SceneError("/support/pose", _why_not_level("the support", body, table))
    T_world_support = settled(face, body.T_world_body, table.height)
    corners = footprint(face, T_world_support)
    if overhang(polygon.centroid(corners)[None], table) > 0.0:
        raise SceneError("/support/pose", "the centre of the support is not over the table")
    return replace(body, T_world_body=T_world_support)


def place_plate(task: PlateLiftTask, support: Body | None, table: Surface) -> tuple[Plate, Surface]:
    """Settle the plate on the support or the table, and return it with the surface it rests on."""
    given = task.plate
    solid = solid_of(given.shape)
    com = solid.centroid if given.com is None else np.array(given.com)
    T_world_plate = from_pose7(task.plate_pose)
    plate = Plate("plate", "plate", given.shape, solid, given.mass, com, T_world_plate, static=False)
    if plate.solid.depth(com) < -CONTAINMENT_SLACK:
        raise SceneError("/plate/com", "the centre of mass is not inside the plate")
    if T_world_plate[2, 2] <= 0.0:
        detail = "the plate lies upside down or on its side: its +z must point up"
        raise SceneError("/plate_pose", detail + scalar_last_hint(T_world_plate))
    surface = _surface_below(plate, support, table)
    face = plate.solid.flat_faces()[0]
    if not rests_level(face, T_world_plate, surface.height):
        raise SceneError("/plate_pose", _why_not_level("the plate", plate, surface))
    T_world_plate = settled(face, T_world_plate, surface.height)
    _check_footprint(footprint(face, T_world_plate), surface)
    return replace(plate, T_world_body=T_world_plate), surface


def place_obstacle(index: int, obstacle: Obstacle, shapes: ShapeSource) -> Body:
    """Place the obstacle of this index; it may be anywhere."""
    stated, solid = shapes.find(obstacle.shape, f"/obstacles/{index}/shape")
    T_world_obstacle = from_pose7(obstacle.pose)
    return Body(obstacle.name, "obstacle", stated, solid, None, np.zeros(3), T_world_obstacle, static=True)


def _surface_below(plate: Plate, support: Body | None, table: Surface) -> Surface:
    """Return the surface nearest to the plate's bottom face."""
    surfaces = [table]
    if support is not None:
        top = upper_surface("support", support.solid, support.T_world_body)
        if top is None:
            raise SceneError("/support/pose", "the support has no level face on top")
        surfaces.insert(0, top)
    face = plate.solid.flat_faces()[0]
    return min(surfaces, key=lambda surface: float(np.abs(gaps(face, plate.T_world_body, surface.height)).max()))


def _why_not_level(who: str, body: Body, surface: Surface) -> str:
    face = lowest_face(body.solid, body.T_world_body)
    tilt = face_tilt(face, body.T_world_body)
    if tilt > REST_TILT:
        degrees = math.degrees(tilt)
        hint = scalar_last_hint(body.T_world_body)
        return f"{who} is tilted by {degrees:.3g} degrees; a resting face is level within 0.1 degrees{hint}"
    heights = gaps(face, body.T_world_body, surface.height)
    farthest = 1e3 * float(heights[np.argmax(np.abs(heights))])
    where = "above" if farthest > 0.0 else "below"
    return (
        f"{who} rests on nothing: its bottom face is {abs(farthest):.4g} mm {where} the top of the {surface.name}, "
        f"more than {1e3 * REST_GAP:g} mm"
    )


def _check_footprint(corners: Array, surface: Surface) -> None:
    """Refuse a plate whose bottom face is not wholly on its surface."""
    beyond = overhang(corners, surface)
    if beyond == 0.0:
        return
    if surface.name == "support" and polygon.area(corners) > polygon.area(surface.outline):
        raise SceneError("/support/shape", "the support is smaller than the plate: its whole bottom face must rest")
    detail = f"the plate's bottom face sticks out {1e3 * beyond:.4g} mm over the edge of the {surface.name}"
    raise SceneError("/plate_pose", detail)
