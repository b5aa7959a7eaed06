"""Files that `liftwright plan` reads: a task, and a scene that it takes its objects from."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from app.bad_input import BadInput
from planners.contract.problems import problems_of
from planners.contract.scene_document import SceneDocument
from planners.contract.strict_json import NotJson, parse_json

SCENES = "`liftwright scene --out FILE` writes one"


def read_task_file(path: Path) -> Any:
    """Return the JSON data of a file that may be a task.

    Raises:
        BadInput: It is not JSON, or what another command or the service has written.
        OSError: It cannot be read.
    """
    sent = _read_json(path)
    members: Mapping[str, Any] = sent if isinstance(sent, dict) else {}
    if {"segments", "certificate", "task"} <= members.keys():
        raise BadInput(f'{path} is a plan document, not a task; the one it was planned from is its member "task"')
    if {"table", "unrecognised"} <= members.keys():
        raise BadInput(
            f"{path} is a scene, not a task; give it as --scene {path}, beside a task that names its objects"
        )
    return sent


def read_scene_file(path: Path) -> SceneDocument:
    """Return the scene in a file.

    Raises:
        BadInput: There is none.
        OSError: It cannot be read.
    """
    try:
        return SceneDocument.model_validate_json(json.dumps(_read_json(path)))
    except ValidationError as error:
        first = problems_of(error)[0]
        where = f"{first['pointer']} " if first["pointer"] else ""
        raise BadInput(f"{path} is not a scene ({where}{first['detail']}); {SCENES}") from error


def _read_json(path: Path) -> Any:
    try:
        return parse_json(path.read_bytes(), "the file")
    except NotJson as error:
        raise BadInput(f"{path}: {error}") from error
