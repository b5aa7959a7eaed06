"""The hand-held suction tool: a body with a cup at its origin."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from planners.cell.asset_files import ToolFile
from planners.cell.asset_shelf import described_tool, shipped_shelf, shipped_tool
from planners.cell.cell import Cell
from planners.cell.cell_tool import CellTool
from planners.contract.shapes import InlineMesh
from planners.contract.task_spec import CustomTool, ToolCup, ToolPart
from planners.errors import SceneError
from planners.geometry.pose import Array, Transform, from_pose7
from planners.geometry.solid_mesh import SolidMesh
from planners.scene.body import Body
from planners.scene.placements import in_hull
from planners.scene.rest import REST_GAP
from planners.scene.shape_source import ShapeSource, mesh_solid
from planners.scene.solid import CompoundSolid, solid_of

TOOL_NAME = "tool"


@dataclass(frozen=True)
class CupData:
    """The suction cup: what its hold depends on."""

    radius: float
    """[m]"""
    max_force: float
    """Largest suction force [N]."""
    mu: float
    kappa: float
    """[N], see the suction model."""


@dataclass(frozen=True, eq=False)
class SuctionTool:
    """A suction tool; its origin is the centre of the cup's lip, +z runs from the cup up the shaft."""

    name: str
    """Which tool it is: the name of a shipped one or of one that its cell brings, or "custom"."""
    body: Body
    """Named "tool", where it is at the start."""
    mass: float
    """[kg]"""
    com: Array
    """(3,) in the tool frame [m]."""
    cup: CupData
    supports: tuple[str, ...] = ()
    """What carries it at the start: names of bodies, "table" among them."""

    @property
    def T_world_tool(self) -> Transform:
        """The tool at the start."""
        return self.body.T_world_body

    def at(self, T_world_tool: Transform) -> SuctionTool:
        """Return the same tool somewhere else."""
        return replace(self, body=replace(self.body, T_world_body=T_world_tool))


NO_TOOLS: Mapping[str, SuctionTool] = MappingProxyType({})


def known_tools() -> list[str]:
    """List the names of the tools that are shipped."""
    return shipped_shelf().names("tools")


def load_tools() -> dict[str, SuctionTool]:
    """Load all tools that are shipped, by name."""
    return {name: load_tool(name) for name in known_tools()}


def tool_descriptions() -> dict[str, CustomTool]:
    """Return every shipped tool by name, as a task would describe it."""
    return {name: described_tool(name) for name in known_tools()}


def tools_in(cell: Cell) -> list[str]:
    """List the names by which a task in a cell may name a tool: the shipped ones and those that the cell brings."""
    return sorted({*known_tools(), *cell.tools})


def tool_file(name: str, cell: Cell) -> ToolFile:
    """Return the file of the tool that a task or a scan in a cell names; the cell's own come first.

    Raises:
        SceneError: There is no tool of this name.
    """
    if name in cell.tools:
        return cell.tools[name].file
    if name not in known_tools():
        raise SceneError("/tool", f"there is no tool {name} in the cell {cell.name}", tools_in(cell))
    return shipped_tool(name)


def find_tool(
    tool: str | CustomTool,
    cell: Cell,
    shapes: ShapeSource | None = None,
    loaded: Mapping[str, SuctionTool] = NO_TOOLS,
) -> SuctionTool:
    """Return the tool that a task in a cell names or describes, at the world's origin; the cell's own come first.

    Args:
        tool: name or description.
        cell: in which the task is.
        shapes: where meshes of a description come from; None: the shipped ones alone.
        loaded: shipped tools that were loaded before; others are read from their files.

    Raises:
        SceneError: There is no tool of this name, or a mesh of the task's own is not there or cannot be used.
    """
    if isinstance(tool, str) and tool in cell.tools:
        return tool_of_cell(cell.tools[tool])
    if isinstance(tool, str) and tool in loaded:
        return loaded[tool]
    if isinstance(tool, str):
        tool_file(tool, cell)
    return load_tool(tool, shapes)


def tool_of_cell(given: CellTool) -> SuctionTool:
    """Build a tool that a cell brings; it is at the world's origin."""
    pieces = [
        (mesh_solid(part.shape) if isinstance(part.shape, SolidMesh) else solid_of(part.shape), from_pose7(part.pose))
        for part in given.parts
    ]
    described = given.file.tool
    return _built(given.file.name, CompoundSolid(tuple(pieces)), described.mass, np.array(described.com), described.cup)


def check_tool(tool: SuctionTool) -> None:
    """Refuse what cannot be a tool with its cup's lip at the origin.

    Raises:
        SceneError: It points at the member `tool` of a task; a tool's own file has one of the same name.
    """
    if not in_hull(tool.body.solid, tool.com):
        raise SceneError("/tool/com", "the centre of mass is not inside the tool")
    lowest = float(tool.body.solid.surface()[0][:, 2].min())
    if abs(lowest) > REST_GAP:
        where = "below" if lowest < 0.0 else "above"
        detail = f"the tool ends {1e3 * abs(lowest):.4g} mm {where} its origin, which is the centre of the cup's lip"
        raise SceneError("/tool/shapes", detail)


def load_tool(tool: str | CustomTool, shapes: ShapeSource | None = None) -> SuctionTool:
    """Load a shipped tool by its name, or build one that a task describes; it is at the world's origin.

    Args:
        tool: name or description.
        shapes: where meshes come from; None: the shipped ones alone.

    Raises:
        AssetError: There is no tool of this name, or its file is wrong.
        SceneError: A mesh of a task's own tool is not there or cannot be used.
    """
    name, given = "custom", tool
    if isinstance(given, str):
        name, given = given, described_tool(given)
    solid = _solid(given.shapes, shapes or ShapeSource())
    com = solid.centroid if given.com is None else np.array(given.com)
    return _built(name, solid, given.mass, com, given.cup)


def _built(name: str, solid: CompoundSolid, mass: float, com: Array, cup: ToolCup) -> SuctionTool:
    stated = InlineMesh.of(*solid.surface(), (part.vertices for part in solid.convex_parts))
    body = Body(TOOL_NAME, "tool", stated, solid, mass, com, np.eye(4), static=False)
    return SuctionTool(name, body, mass, com, CupData(cup.radius, cup.max_force, cup.mu, cup.kappa))


def _solid(parts: tuple[ToolPart, ...], shapes: ShapeSource) -> CompoundSolid:
    pointed = ((part, f"/tool/shapes/{i}/shape") for i, part in enumerate(parts))
    pieces = ((shapes.find(part.shape, where)[1], from_pose7(part.pose)) for part, where in pointed)
    return CompoundSolid(tuple(pieces))
