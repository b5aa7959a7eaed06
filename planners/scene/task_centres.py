"""The centres of mass that a task leaves to its shapes."""

from __future__ import annotations

from planners.contract.quantities import Point3
from planners.contract.task_spec import CustomTool, PlateLiftTask, SuctionToolTask
from planners.geometry.pose import Array
from planners.scene.scene import PlateLiftScene
from planners.scene.tool_scene import SuctionToolScene


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
