"""What a draft can begin with: an example, a plan's task, or what was perceived in a scene."""

from __future__ import annotations

from collections.abc import Mapping
from http import HTTPStatus
from importlib import resources
from itertools import chain
from typing import Any

from app.errors import CellNotDrawn, ServiceError
from app.example_tasks import example_tasks
from planners.cell.cell import Cell
from planners.contract.scene_document import SceneDocument
from planners.contract.strict_json import parse_json
from planners.perception.scene_task import fill_from_scene


class NoSuchExample(ServiceError, status=HTTPStatus.NOT_FOUND, title="No such example"):
    """No example task has that name."""

    def __init__(self, name: str) -> None:
        known = sorted(chain.from_iterable(example_tasks().values()))
        super().__init__(f"there is no example {name[:100]!r}; there are {', '.join(known)}")


def example_task(name: str) -> dict[str, Any]:
    """Return a shipped task as JSON data.

    Raises:
        NoSuchExample: There is none of that name.
    """
    if name not in chain.from_iterable(example_tasks().values()):
        raise NoSuchExample(name)
    return parse_json(resources.files("assets").joinpath("tasks", f"{name}.json").read_bytes())


def task_of_scene(scene: SceneDocument, cells: Mapping[str, Cell]) -> dict[str, Any]:
    """Return a suction-tool task with all objects of a scene, each to be left where it is; masses are not known.

    Raises:
        CellNotDrawn: The scene's cell is not there.
        SceneError: The scene does not fit its cell.
    """
    if scene.cell not in cells:
        raise CellNotDrawn(scene.cell, sorted(cells))
    wanted = {"kind": "suction_tool", "objects": [{"detection": part.name} for part in scene.objects]}
    task = fill_from_scene(wanted, scene, cells[scene.cell])
    # What was perceived stands in the task now, where it can be moved: nothing is left to look up.
    objects = [{**each, "goal_pose": list(each["pose"])} for each in task["objects"]]
    return {**task, "objects": objects}
