"""From a perceived scene and what is wanted of its objects to a suction-tool task.

A task that names a scene leaves out what was perceived: shapes and start poses of its objects, the tool's pose, and
what else is there. An object of the task is found by its `detection`, or by its own name.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain, count
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial import ConvexHull

from planners.cell.cell import Cell
from planners.contract.scene_document import TABLE, ObjectPart, SceneDocument, SeenToolPart
from planners.contract.shapes import Box, Cylinder
from planners.errors import SceneError
from planners.geometry import polygon
from planners.geometry.pose import Array, Transform, from_pose7, rotation_z, to_pose7, transform

CERTAINTY = 2.0
"""Sides are moved out by so many of the uncertainties that are told: 19 of 20 are inside [1]."""
SHARE_OF_GAP = 0.45
"""... but by no more than this share of the gap to a neighbour [1]."""
LEAST_GAP = 1e-3
"""Between perceived things; what was seen closer together is made so much narrower [m]."""
NARROWEST = 0.010
"""No side is made narrower than this by it [m]."""
TABLE_ERROR = 0.010
"""If the table was seen farther off its height in the cell, the camera's pose is wrong [m]."""
TABLE_LEAN = math.radians(1.5)
"""... or more tilted [rad]."""
UPRIGHT = math.radians(5.0)
"""A tool that was seen less off the vertical stands upright [rad]."""
STANDING = 0.010
"""... and on the table, if its cup was seen within this [m]."""
GOAL_REACH = 0.015
"""A goal so near above or below what can carry it is meant to be on it [m]."""
LOWEST_OBSTACLE = 0.005
"""[m]"""
OUTLINE_CORNERS = 24
"""Of what was not recognised [1]."""
NAMED = ("shape", "pose")


@dataclass(frozen=True, eq=False)
class UprightObject:
    """A perceived object as a task has it: upright, with clearance, exactly on what carries it."""

    part: ObjectPart
    size: tuple[float, float, float]
    """Sides with clearance, and height; of a cylinder the diameter twice."""
    T_world_object: Transform

    @property
    def top(self) -> float:
        """Z of its top [m]."""
        return float(self.T_world_object[2, 3] + 0.5 * self.size[2])

    @property
    def shape(self) -> Box | Cylinder:
        """As a task names it."""
        if self.part.shape.type == "box":
            return Box(type="box", size=self.size)
        return Cylinder(type="cylinder", radius=0.5 * self.size[0], height=self.size[2])


def fill_from_scene(body: Mapping[str, Any], scene: SceneDocument, cell: Cell) -> dict[str, Any]:
    """Return a task's body with everything put in that it leaves to its scene; what it says itself stays.

    Sizes have the clearance that their uncertainty asks for; poses rest on the cell's table. Detections that the task
    does not name, and what was not recognised, become obstacles. Goals of upright objects are put down on what is less
    than `GOAL_REACH` below or above them, since nobody knows perceived heights beforehand.

    Args:
        body: JSON data with the member `scene_id`; not validated.
        scene: that it names.
        cell: where it was perceived.

    Raises:
        SceneError: The scene does not fit the task or the cell, or has no such object.
    """
    _check_fit(body.get("cell", scene.cell), scene, cell)
    if scene.table is None and _needs_objects(body.get("objects")):
        raise SceneError("/scene_id", "the scene was perceived without depth or cloud: it has no objects")
    standing = stand_up(scene, cell)
    filled = dict(body)
    filled.setdefault("cell", scene.cell)
    if scene.tool is not None and filled.get("tool", scene.tool.name) == scene.tool.name:
        filled.setdefault("tool", scene.tool.name)
        if filled.get("tool_pose") is None:
            filled["tool_pose"] = to_pose7(_settled_tool(scene.tool, cell))
    used: set[str] = set()
    given = body.get("objects")
    if isinstance(given, list):
        objects = [_filled_object(i, each, standing, used) for i, each in enumerate(given)]
        filled["objects"] = _with_goals_put_down(objects, cell.table_top)
    left = [each for each in standing if each.part.name not in used]
    extra = _obstacles(left, scene, cell, _names_in(filled))
    obstacles = body.get("obstacles", [])
    if extra and isinstance(obstacles, list):
        filled["obstacles"] = [*obstacles, *extra]
    return filled | {"scene_filled": True}


def stand_up(scene: SceneDocument, cell: Cell) -> list[UprightObject]:
    """Put a scene's objects upright onto the cell's table and onto one another, with clearance all round."""
    clearances = _clearances(scene.objects)
    done: dict[str, UprightObject] = {}
    for part in scene.from_the_table_up():
        bottom = cell.table_top if part.supported_by == TABLE else done[part.supported_by].top
        x, y, z = _size(part)
        beyond = 2.0 * clearances[part.name]
        size = (max(NARROWEST, x + beyond), max(NARROWEST, y + beyond), z)
        T = from_pose7(part.pose)
        yaw = math.atan2(T[1, 0], T[0, 0])
        done[part.name] = UprightObject(
            part, size, transform(rotation_z(yaw), [part.pose[0], part.pose[1], bottom + 0.5 * z])
        )
    return [done[part.name] for part in scene.objects]


def _check_fit(wanted: object, scene: SceneDocument, cell: Cell) -> None:
    """Refuse another cell than the one that is wanted, or a camera whose pose is wrong."""
    if wanted != scene.cell:
        raise SceneError("/cell", f"the scene was perceived in the cell {scene.cell}", [scene.cell])
    if scene.table is None:
        return
    off = abs(scene.table.height - cell.table_top)
    lean = math.acos(min(1.0, abs(scene.table.normal[2])))
    if off > TABLE_ERROR or lean > TABLE_LEAN:
        raise SceneError(
            "/scene_id",
            f"the table was seen {1e3 * off:.1f} mm off its height and {math.degrees(lean):.2f} degrees off level; up "
            f"to {1e3 * TABLE_ERROR:g} mm and {math.degrees(TABLE_LEAN):.1f} degrees are taken for the camera's error",
        )


def _needs_objects(given: object) -> bool:
    return isinstance(given, list) and any(isinstance(each, dict) and _is_perceived(each) for each in given)


def _is_perceived(given: Collection[str]) -> bool:
    return "detection" in given or not all(name in given for name in NAMED)


def _filled_object(index: int, given: Any, standing: Sequence[UprightObject], used: set[str]) -> Any:
    if not isinstance(given, dict) or not _is_perceived(given):
        return given
    member = "detection" if "detection" in given else "name"
    wanted = given.get(member)
    known = [each.part.name for each in standing]
    found = next((each for each in standing if each.part.name == wanted), None)
    if found is None:
        raise SceneError(f"/objects/{index}/{member}", "the scene has no such object", known)
    if found.part.name in used:
        raise SceneError(f"/objects/{index}/{member}", f"{found.part.name} is named twice")
    used.add(found.part.name)
    filled = {name: value for name, value in given.items() if name != "detection"}
    filled.setdefault("name", found.part.name)
    filled.setdefault("shape", found.shape.model_dump(mode="json"))
    filled.setdefault("pose", to_pose7(found.T_world_object))
    return filled


def _with_goals_put_down(objects: Sequence[Any], table_top: float) -> list[Any]:
    """Put the goals of boxes and cylinders that stand upright onto what is just below them, from the bottom up."""
    goals = {i: goal for i, each in enumerate(objects) if (goal := _standing_goal(each)) is not None}
    tops: list[tuple[Array, float]] = []
    settled = list(objects)
    for i, (outline, pose, height) in sorted(goals.items(), key=lambda each: each[1].pose[2]):
        below = [table_top, *(top for other, top in tops if len(polygon.overlap(outline, other)) > 2)]
        near = [z for z in below if abs(pose[2] - 0.5 * height - z) <= GOAL_REACH]
        if near:
            pose[2] = max(near) + 0.5 * height
            settled[i] = {**objects[i], "goal_pose": pose}
        tops.append((outline, pose[2] + 0.5 * height))
    return settled


class _Goal(NamedTuple):
    outline: Array
    """(n, 2) [m]."""
    pose: list[float]
    height: float
    """Of the object [m]."""


def _standing_goal(given: Any) -> _Goal | None:
    """Return where an object stands at its goal; None if it is none of ours, or does not stand upright."""
    shape, pose = (given.get("shape"), given.get("goal_pose")) if isinstance(given, dict) else (None, None)
    if not isinstance(pose, list | tuple) or len(pose) != 7 or not all(_is_number(value) for value in pose):
        return None
    if not isinstance(shape, dict) or not np.linalg.norm(pose[3:]) > 0.5:
        return None
    T = from_pose7(pose)
    if T[2, 2] < math.cos(UPRIGHT):
        return None
    match shape:
        case {"type": "box", "size": [x, y, z]} if all(_is_number(side) for side in (x, y, z)):
            corners, height = polygon.rectangle(x, y), float(z)
        case {"type": "cylinder", "radius": r, "height": h} if _is_number(r) and _is_number(h):
            corners, height = polygon.circle(r, 24), float(h)
        case _:
            return None
    return _Goal(corners @ T[:2, :2].T + T[:2, 3], list(pose), height)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value) and abs(value) < 1e3


def _settled_tool(tool: SeenToolPart, cell: Cell) -> Transform:
    """Stand a tool up that was seen nearly upright on the table; seen from above, its markers stay in their place."""
    T_seen = from_pose7(tool.pose)
    if abs(T_seen[2, 3] - cell.table_top) > STANDING or T_seen[2, 2] < math.cos(UPRIGHT):
        return T_seen
    T = transform(rotation_z(math.atan2(T_seen[1, 0] - T_seen[0, 1], T_seen[0, 0] + T_seen[1, 1])))
    markers_in_tool = T_seen[:3, :3].T @ (np.array(tool.markers_at) - T_seen[:3, 3])
    T[:3, 3] = np.array(tool.markers_at) - T[:3, :3] @ markers_in_tool
    T[2, 3] = cell.table_top
    return T


def _clearances(parts: Sequence[ObjectPart]) -> dict[str, float]:
    """Return the clearance of each object's sides, by name [m]: their uncertainty, or what a neighbour leaves of it."""
    rings = {part.name: _ring(part) for part in parts}
    clearances = {}
    for part in parts:
        # A side is off by what the centre is, and by half of what the size is.
        wanted = CERTAINTY * math.hypot(max(part.uncertainty.position[:2]), 0.5 * max(part.uncertainty.size[:2]))
        for other in parts:
            if other.name != part.name and _share_height(part, other):
                gap = _gap(rings[part.name], rings[other.name])
                wanted = min(wanted, SHARE_OF_GAP * gap if gap > LEAST_GAP else 0.5 * (gap - LEAST_GAP))
        clearances[part.name] = wanted
    return clearances


def _share_height(a: ObjectPart, b: ObjectPart) -> bool:
    if a.supported_by == b.name or b.supported_by == a.name:
        return False
    return abs(a.pose[2] - b.pose[2]) < 0.5 * (_size(a)[2] + _size(b)[2])


def _size(part: ObjectPart) -> tuple[float, float, float]:
    shape = part.shape
    return shape.size if shape.type == "box" else (2.0 * shape.radius, 2.0 * shape.radius, shape.height)


def _ring(part: ObjectPart) -> Array:
    x, y, _ = _size(part)
    corners = polygon.rectangle(x, y) if part.shape.type == "box" else polygon.circle(0.5 * x, 48)
    T = from_pose7(part.pose)
    return corners @ T[:2, :2].T + T[:2, 3]


def _gap(a: Array, b: Array) -> float:
    """Return the distance of two convex outlines (n, 2) [m], negative by how deep they overlap."""
    separation = max(_beyond(a, b), _beyond(b, a))
    if separation <= 0.0:
        return separation
    sides = [np.stack([ring, np.roll(ring, -1, axis=0)], axis=1) for ring in (a, b)]
    return min(polygon.segment_distance(one, other) for one in sides[0] for other in sides[1])


def _beyond(outline: Array, points: Array) -> float:
    """Return the largest distance [m] by which a single side of a convex outline (k, 2) parts points (n, 2) from it."""
    offsets = (points[:, None, :] - outline[None, :, :]) * polygon.inward_normals(outline)[None, :, :]
    return float(-offsets.sum(axis=2).max(axis=0).min())


def _names_in(task: Mapping[str, Any]) -> set[str]:
    """Return the names of a task's objects and obstacles, as far as they are some."""
    members = [task.get(member) for member in ("objects", "obstacles")]
    bodies = [each for bodies in members if isinstance(bodies, list) for each in bodies]
    names = [each.get("name") for each in bodies if isinstance(each, dict)]
    return {name for name in names if isinstance(name, str)}


def _obstacles(
    left: Sequence[UprightObject], scene: SceneDocument, cell: Cell, taken: set[str]
) -> list[dict[str, Any]]:
    """Return what was seen and is no object of the task, by names that nothing in the task has (`taken`)."""

    def free(name: str) -> str:
        others = (f"{name}_seen_{k}" for k in count(1))
        found = next(each for each in chain([name], others) if each not in taken)
        taken.add(found)
        return found

    obstacles: list[dict[str, Any]] = []
    for each in left:
        shape, pose = each.shape.model_dump(mode="json"), to_pose7(each.T_world_object)
        obstacles.append({"name": free(each.part.name), "shape": shape, "pose": pose})
    for i, piece in enumerate(scene.unrecognised):
        height = max(LOWEST_OBSTACLE, piece.top - cell.table_top)
        outline = np.array(piece.outline)
        center = 0.5 * (outline.min(axis=0) + outline.max(axis=0))
        shape = {"type": "prism", "outline": _simple(outline - center).tolist(), "height": height}
        pose = [float(center[0]), float(center[1]), cell.table_top + 0.5 * height, 1.0, 0.0, 0.0, 0.0]
        obstacles.append({"name": free(f"unrecognised_{i + 1}"), "shape": shape, "pose": pose})
    return obstacles


def _simple(outline: Array) -> Array:
    """Return a convex outline with few corners round a convex outline: the lines that touch it in even directions."""
    normals = polygon.circle(1.0, OUTLINE_CORNERS)
    reach = (outline @ normals.T).max(axis=0) + 1e-3
    following, reached = np.roll(normals, -1, axis=0), np.roll(reach, -1)
    determinant = normals[:, 0] * following[:, 1] - normals[:, 1] * following[:, 0]
    x = (reach * following[:, 1] - reached * normals[:, 1]) / determinant
    y = (normals[:, 0] * reached - following[:, 0] * reach) / determinant
    corners = np.column_stack([x, y])
    hull = corners[ConvexHull(np.round(corners, 4)).vertices]
    return np.round(hull, 4).astype(float)
