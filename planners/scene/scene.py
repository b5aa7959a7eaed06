"""From a task to its scene, and the centres of mass that a task leaves to its shapes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import overload

from planners.cell.cell import Cell
from planners.contract.quantities import Point3
from planners.contract.task_spec import (
    KINDS,
    CustomTool,
    PlateLiftTask,
    SuctionToolTask,
)
from planners.geometry.pose import Array
from planners.scene.lift_scene import PlateLiftScene, build_lift_scene, lift_cell
from planners.scene.shape_source import Uploads, no_uploads
from planners.scene.suction_tool import NO_TOOLS, SuctionTool
from planners.scene.tool_scene import SuctionToolScene, build_tool_scene, tool_cell

PLANNED_KINDS = KINDS
"""The kinds of task that can be planned."""


@overload
def build_scene(
    task: PlateLiftTask,
    cells: Mapping[str, Cell] | None = None,
    uploads: Uploads = no_uploads,
    tools: Mapping[str, SuctionTool] = NO_TOOLS,
) -> PlateLiftScene: ...


@overload
def build_scene(
    task: SuctionToolTask,
    cells: Mapping[str, Cell] | None = None,
    uploads: Uploads = no_uploads,
    tools: Mapping[str, SuctionTool] = NO_TOOLS,
) -> SuctionToolScene: ...


@overload
def build_scene(
    task: PlateLiftTask | SuctionToolTask,
    cells: Mapping[str, Cell] | None = None,
    uploads: Uploads = no_uploads,
    tools: Mapping[str, SuctionTool] = NO_TOOLS,
) -> PlateLiftScene | SuctionToolScene: ...


def build_scene(
    task: PlateLiftTask | SuctionToolTask,
    cells: Mapping[str, Cell] | None = None,
    uploads: Uploads = no_uploads,
    tools: Mapping[str, SuctionTool] = NO_TOOLS,
) -> PlateLiftScene | SuctionToolScene:
    """Place everything a task names, and refuse what cannot stand as it says.

    Args:
        task: What is asked for.
        cells: The cells there are, by name. None: the shipped ones, read from their files, which takes most of the
            time.
        uploads: Finds the meshes that the task names as uploads.
        tools: Suction tools that were loaded before, by name; others are read from their files.

    Raises:
        SceneError: naming the member that is wrong, and the valid choices where there are any.
    """
    if isinstance(task, SuctionToolTask):
        return build_tool_scene(task, cells, uploads, tools)
    return build_lift_scene(task, cells, uploads)


def cell_of(task: PlateLiftTask | SuctionToolTask, cells: Mapping[str, Cell] | None = None) -> Cell:
    """Return the cell that a task names, of those there are by name; None: the shipped ones.

    Raises:
        SceneError: There is none, or it has not the hands that the task needs; with the names of those that have.
    """
    return tool_cell(task, cells) if isinstance(task, SuctionToolTask) else lift_cell(task, cells)


def with_centres(
    task: PlateLiftTask | SuctionToolTask, scene: PlateLiftScene | SuctionToolScene
) -> PlateLiftTask | SuctionToolTask:
    """Return a task with every centre of mass that it leaves out: what is planned with, and stated in documents.

    Args:
        task: as read.
        scene: built from it; finding the centroid of a mesh takes the mesh.
    """
    if isinstance(task, PlateLiftTask) and isinstance(scene, PlateLiftScene):
        return task.model_copy(update={"plate": task.plate.model_copy(update={"com": _numbers(scene.plate.com)})})
    if isinstance(task, SuctionToolTask) and isinstance(scene, SuctionToolScene):
        objects = tuple(
            given.model_copy(update={"com": _numbers(moved.body.com)})
            for given, moved in zip(task.objects, scene.objects, strict=True)
        )
        tool = task.tool
        if isinstance(tool, CustomTool):
            tool = tool.model_copy(update={"com": _numbers(scene.tool.com)})
        return task.model_copy(update={"objects": objects, "tool": tool})
    return task


def _numbers(com: Array) -> Point3:
    x, y, z = com.tolist()
    return x, y, z
