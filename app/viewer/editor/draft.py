"""A draft: a task as far as somebody has come with it, and the things in it that can be drawn and moved."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from pydantic import TypeAdapter, ValidationError

from planners.cell.cell import Cell
from planners.contract.quantities import Length, Name, Point2, Pose
from planners.contract.shapes import Box, Cylinder, InlineMesh, Mesh, Prism, Shape
from planners.contract.task_spec import DEFAULT_CELLS, CustomTool, SuctionToolTask
from planners.errors import LiftwrightError
from planners.geometry.pose import Array, Transform, from_pose7
from planners.scene.body import Role
from planners.scene.shape_source import ShapeSource
from planners.scene.solid import Solid
from planners.scene.suction_tool import TOOL_NAME, SuctionTool, find_tool

Read = TypeVar("Read")
SHAPE: TypeAdapter[Box | Cylinder | Prism | Mesh] = TypeAdapter(Shape)
POSE: TypeAdapter[tuple[float, ...]] = TypeAdapter(Pose)
PLACE: TypeAdapter[tuple[float, float]] = TypeAdapter(Point2)
LENGTH: TypeAdapter[float] = TypeAdapter(Length)
TOOL: TypeAdapter[str | CustomTool] = TypeAdapter(Name | CustomTool)
DEFAULT_TOOL = SuctionToolTask.model_fields["tool"].default
PLATE, SUPPORT, CUP, TOOL_POSE = "/plate_pose", "/support/pose", "/cup/position", "/tool_pose"
"""Pointers by which things are known: the member that says where a thing is."""


@dataclass(frozen=True, eq=False)
class DraftPart:
    """One thing of a draft: a body where the task has it, at the start or at its goal."""

    pointer: str
    """Of its pose in the task (RFC 6901); no two things have the same."""
    name: str
    """As a person reads it."""
    role: Role
    shape: Box | Cylinder | Prism | InlineMesh
    solid: Solid
    T_world_body: Transform

    @property
    def is_goal(self) -> bool:
        """Whether it is where an object is wanted."""
        return self.pointer.endswith("/goal_pose")

    @property
    def rests(self) -> bool:
        """Whether it has to rest on something; an obstacle may be anywhere."""
        return self.role != "obstacle"


@dataclass(frozen=True)
class DraftCup:
    """The lifter's cup on the plate's top face."""

    position: tuple[float, float]
    """In plate axes [m]."""
    radius: float
    """[m]"""


@dataclass(frozen=True, eq=False)
class Draft:
    """What can be drawn of a task; members that are missing or wrong are left out, whatever else is wrong."""

    parts: Mapping[str, DraftPart]
    """By pointer."""
    cup: DraftCup | None
    """None, too, where there is no plate to put it on."""

    @property
    def plate(self) -> DraftPart | None:
        """The plate of a plate lift."""
        return self.parts.get(PLATE)


def cell_of(task: Any) -> str | None:
    """Return the name of the cell that a task is for; None where it does not say."""
    kind = task.get("kind") if isinstance(task, dict) else None
    default = DEFAULT_CELLS.get(kind) if isinstance(kind, str) else None
    name = task.get("cell", default) if isinstance(task, dict) else None
    return name if isinstance(name, str) else None


def read_draft(task: Any, cell: Cell, shapes: ShapeSource, tools: Mapping[str, SuctionTool]) -> Draft:
    """Read what can be drawn of a task, as JSON data.

    Args:
        task: finished or not.
        cell: that it is for; its rest is where a tool is that the task says nothing of.
        shapes: where meshes come from.
        tools: shipped tools that were loaded before, by name.
    """
    if not isinstance(task, dict):
        return Draft({}, None)
    reader = _PartReader(shapes, {})
    if task.get("kind") == "plate_lift":
        reader.add(PLATE, "plate", "plate", _member(task, "plate", "shape"), task.get("plate_pose"))
        reader.add(SUPPORT, "support", "support", _member(task, "support", "shape"), _member(task, "support", "pose"))
    else:
        _add_tool(reader, task, cell, tools)
        for i, each in enumerate(_dicts(task.get("objects"))):
            name = str(each.get("name", f"object {i + 1}"))
            for member, words in (("pose", name), ("goal_pose", f"{name}, goal")):
                reader.add(f"/objects/{i}/{member}", words, "object", each.get("shape"), each.get(member))
    for i, each in enumerate(_dicts(task.get("obstacles"))):
        name = str(each.get("name", f"obstacle {i + 1}"))
        reader.add(f"/obstacles/{i}/pose", name, "obstacle", each.get("shape"), each.get("pose"))
    return Draft(reader.parts, _cup(task) if PLATE in reader.parts else None)


@dataclass(frozen=True)
class _PartReader:
    shapes: ShapeSource
    parts: dict[str, DraftPart]

    def add(self, pointer: str, name: str, role: Role, shape: Any, pose: Any) -> None:
        """Add a thing, if its shape and its pose can be read."""
        known, place = _read(SHAPE, shape), _read(POSE, pose)
        if known is None or place is None:
            return
        try:
            stated, solid = self.shapes.find(known, pointer)
        except LiftwrightError:
            return  # There is no such mesh, which the check of the task tells.
        self.parts[pointer] = DraftPart(pointer, name, role, stated, solid, from_pose7(place))


def _add_tool(reader: _PartReader, task: dict[str, Any], cell: Cell, tools: Mapping[str, SuctionTool]) -> None:
    wanted, given = _read(TOOL, task.get("tool", DEFAULT_TOOL)), task.get("tool_pose")
    place = _read(POSE, given)
    rest = None if cell.tool_rest is None else cell.tool_rest.T_world_tool
    T_world_tool = from_pose7(place) if place is not None else rest
    if wanted is None or T_world_tool is None or (given is not None and place is None):
        return
    try:
        tool = find_tool(wanted, cell, reader.shapes, tools)
    except LiftwrightError:
        return
    body = tool.body
    reader.parts[TOOL_POSE] = DraftPart(TOOL_POSE, TOOL_NAME, "tool", body.shape, body.solid, T_world_tool)


def _cup(task: dict[str, Any]) -> DraftCup | None:
    position, radius = (_member(task, "cup", name) for name in ("position", "radius"))
    place, size = _read(PLACE, position), _read(LENGTH, radius)
    return None if place is None or size is None else DraftCup(place, size)


def _read(adapter: TypeAdapter[Read], value: Any) -> Read | None:
    try:
        return adapter.validate_python(value)
    except ValidationError:
        return None


def _member(task: dict[str, Any], *names: str) -> Any:
    value: Any = task
    for name in names:
        value = value.get(name) if isinstance(value, dict) else None
    return value


def _dicts(value: Any) -> list[dict[str, Any]]:
    """Return the items of an array with what is no object made an empty one, so that the others keep their numbers."""
    return [each if isinstance(each, dict) else {} for each in value] if isinstance(value, list) else []


def cup_in_world(plate: DraftPart, cup: DraftCup) -> Array:
    """Return the centre of the pad (3,) on the plate's top face, in the world [m]."""
    x, y = cup.position
    top = float(plate.solid.surface()[0][:, 2].max())
    return (plate.T_world_body @ np.array([x, y, top, 1.0]))[:3]
