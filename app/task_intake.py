"""From the bytes of a request to a task that can be planned."""

from __future__ import annotations

import hashlib
import threading
from abc import abstractmethod
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

from planners.cell.cell import Cell
from planners.contract.scene_document import SceneDocument
from planners.contract.task_spec import PlateLiftTask, SuctionToolTask, read_task
from planners.errors import SceneError
from planners.perception.scene_task import fill_from_scene
from planners.scene.scene import build_scene, cell_of, with_centres
from planners.scene.shape_source import Uploads, no_uploads
from planners.scene.suction_tool import NO_TOOLS, SuctionTool

AcceptedTask = PlateLiftTask | SuctionToolTask
PLACING_NOTHING = MappingProxyType({"external_id": None, "seed": 0})
"""Members of tasks on which it does not depend whether they can be begun, and what stands for them all."""
SceneFinder = Callable[[str], SceneDocument | None]
"""Finds what was perceived in a scene, by its id; None if there is none."""


class VersionedCells(Mapping[str, Cell]):
    """Cells by what a task may call them, some of which get newer versions under the same name."""

    @abstractmethod
    def lasting_name(self, name: str) -> str:
        """Return by what a task is to name a cell for good; what does not exist keeps its name."""


class NeedsScene(SceneError):
    """A task takes an object from a scene and names none."""

    def __init__(self) -> None:
        super().__init__("/scene_id", 'is required: an object has a "detection", which is looked up in a scene')


class KnownTasks:
    """Tasks in which everything was found to rest and to be clear of the rest, with their centres of mass.

    Callers post the same part again and again, under another name or with another seed; neither places anything. Safe
    to share between threads.
    """

    def __init__(self, most: int = 1000) -> None:
        """Remember so many tasks, those that came last [1]."""
        self._most, self._tasks, self._lock = most, dict[bytes, AcceptedTask](), threading.Lock()

    def completed(self, task: AcceptedTask, complete: Callable[[AcceptedTask], AcceptedTask]) -> AcceptedTask:
        """Return what `complete` makes of a task, or has made of one that differs in nothing that places something.

        Raises:
            SceneError: What is wrong with it, as `complete` says.
        """
        named = {name: getattr(task, name) for name in PLACING_NOTHING}
        unnamed = task.model_copy(update=PLACING_NOTHING)
        key = hashlib.sha256(unnamed.model_dump_json().encode()).digest()
        known = self._tasks.get(key) or complete(unnamed)
        with self._lock:
            self._tasks.pop(key, None)
            self._tasks[key] = known
            if len(self._tasks) > self._most:
                del self._tasks[next(iter(self._tasks))]
        return known.model_copy(update=named)


def no_scenes(scene_id: str) -> SceneDocument | None:
    """Know of no scene."""
    return None


def accept_task(
    sent: Any,
    cells: Mapping[str, Cell],
    uploads: Uploads = no_uploads,
    scenes: SceneFinder = no_scenes,
    tools: Mapping[str, SuctionTool] = NO_TOOLS,
    known: KnownTasks | None = None,
) -> AcceptedTask:
    """Return a task with every default filled in, once it is known that it can be begun.

    Args:
        sent: the task as JSON data.
        cells: that there are, by name.
        uploads: finds meshes.
        scenes: finds perceived scenes, which a task may name in place of poses.
        tools: that were loaded before, by name; others are read from their files.
        known: tasks that were found right with the same cells, uploads and tools; None: each is looked at anew.

    Raises:
        pydantic.ValidationError, SceneError: What is wrong with it.
    """
    task = read_task(with_parts(sent, cells, scenes))
    # Also of a task that is known: the cell may have been deleted since.
    cell_of(task, cells)

    def complete(unnamed: AcceptedTask) -> AcceptedTask:
        return with_centres(unnamed, build_scene(unnamed, cells, uploads=uploads, tools=tools))

    return complete(task) if known is None else known.completed(task, complete)


def with_parts(body: Any, cells: Mapping[str, Cell], scenes: SceneFinder) -> Any:
    """Return a task as sent with what it takes from a perceived scene, and with the name that its cell will keep.

    Raises:
        SceneError: There is no such scene.
    """
    if isinstance(body, dict) and isinstance(body.get("cell"), str):
        body = {**body, "cell": _lasting_name(body["cell"], cells)}
    return with_scene(body, cells, scenes)


def with_scene(body: Any, cells: Mapping[str, Cell], scenes: SceneFinder) -> Any:
    """Return a task as sent with what it takes from a perceived scene, if it names one.

    Raises:
        SceneError: There is no such scene.
    """
    if not isinstance(body, dict) or body.get("kind") != "suction_tool" or body.get("scene_filled") is True:
        return body
    scene_id = body.get("scene_id")
    if scene_id is None:
        objects = body.get("objects")
        if isinstance(objects, list) and any(isinstance(each, dict) and "detection" in each for each in objects):
            raise NeedsScene
        return body
    scene = scenes(scene_id) if isinstance(scene_id, str) else None
    if scene is None:
        raise SceneError("/scene_id", "there is no such scene; POST a scan to /v1/scenes")
    cell = cells.get(scene.cell)
    if cell is None:
        raise SceneError("/scene_id", f"the scene was perceived in the cell {scene.cell}, which there is not")
    # Scenes that are older than versions in their names say the cell's own.
    scene = scene.model_copy(update={"cell": _lasting_name(scene.cell, cells)})
    return fill_from_scene(body, scene, cell)


def _lasting_name(name: str, cells: Mapping[str, Cell]) -> str:
    # The newest version of a name is another one tomorrow.
    return cells.lasting_name(name) if isinstance(cells, VersionedCells) else name
