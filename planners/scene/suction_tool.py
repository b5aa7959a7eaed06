"""The hand-held suction tool: a body with a cup at its origin."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from planners.cell.asset_shelf import shipped_shelf, shipped_tool
from planners.contract.shapes import InlineMesh
from planners.contract.task_spec import CustomTool, ToolPart
from planners.geometry.pose import Array, Transform, from_pose7
from planners.scene.body import Body
from planners.scene.shape_source import ShapeSource
from planners.scene.solid import CompoundSolid

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
    """Which tool it is: a shipped one's name, or "custom"."""
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
    return {name: shipped_tool(name).tool for name in known_tools()}


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
        name, given = given, shipped_tool(given).tool
    solid = _solid(given.shapes, shapes or ShapeSource())
    com = solid.centroid if given.com is None else np.array(given.com)
    stated = InlineMesh.of(*solid.surface(), (part.vertices for part in solid.convex_parts))
    body = Body(TOOL_NAME, "tool", stated, solid, given.mass, com, np.eye(4), static=False)
    cup = given.cup
    return SuctionTool(name, body, given.mass, com, CupData(cup.radius, cup.max_force, cup.mu, cup.kappa))


def _solid(parts: tuple[ToolPart, ...], shapes: ShapeSource) -> CompoundSolid:
    pointed = ((part, f"/tool/shapes/{i}/shape") for i, part in enumerate(parts))
    pieces = ((shapes.find(part.shape, where)[1], from_pose7(part.pose)) for part, where in pointed)
    return CompoundSolid(tuple(pieces))
