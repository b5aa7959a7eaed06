"""What a file is that somebody gives a command, and what to do with it where another kind is needed."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from enum import Enum
from pathlib import Path

from app.cli.output import BadInput
from assets import assets_folder
from planners.contract.strict_json import NotJson, parse_json
from planners.contract.strict_yaml import NotYaml, parse_yaml
from planners.contract.task_spec import KINDS
from planners.errors import nearest

YAML_SUFFIXES = frozenset({".yaml", ".yml"})


class FileKind(Enum):
    """What commands read and write; the value is what it is called."""

    TASK = "a task"
    PLAN = "a plan document"
    SCENE = "a scene"
    STUDY = "a study"
    MAP = "the map of a study"
    CELL = "a cell"

    @staticmethod
    def of(content: object) -> FileKind | None:
        """Return what JSON data is by its members, whether or not anything is wrong in it; None: none of these."""
        members = content.keys() if isinstance(content, dict) else frozenset[str]()
        if isinstance(content, dict) and content.get("kind") in KINDS:
            return FileKind.TASK
        return next((kind for kind, has in _MEMBERS.items() if has <= members), None)


_MEMBERS: Mapping[FileKind, frozenset[str]] = {
    FileKind.PLAN: frozenset({"segments", "certificate", "task"}),
    FileKind.SCENE: frozenset({"table", "unrecognised"}),
    FileKind.MAP: frozenset({"task", "axes", "points"}),
    FileKind.STUDY: frozenset({"task", "axes"}),
    FileKind.CELL: frozenset({"arms", "mount"}),
}
_ADVICE: Mapping[FileKind, Callable[[str], str]] = {
    FileKind.TASK: lambda file: f"`liftwright plan {file} --out plan.json` makes a plan document of it",
    FileKind.PLAN: lambda _: 'the task it was planned from is its member "task"',
    FileKind.SCENE: lambda file: f"give it as --scene {file}, beside a task that names its objects",
    FileKind.MAP: lambda _: 'the task that was varied is its member "task"',
    FileKind.STUDY: lambda _: (
        'the task that is varied is its member "task", which `liftwright study` takes with --axis'
    ),
    FileKind.CELL: lambda file: (
        f"`liftwright cell check {file}` says what it can do, and a task is planned in it with --cell {file}"
    ),
}
"""What to do with each, given the name of the file."""


def refuse_other(content: object, named: str, wanted: FileKind) -> None:
    """Refuse JSON data that is something else than what is wanted; what is nothing that is known passes.

    Raises:
        BadInput: It says what it is, and what to do with it.
    """
    kind = FileKind.of(content)
    if kind is not None and kind is not wanted:
        raise BadInput(f"{named} is {kind.value}, not {wanted.value}; {_ADVICE[kind](named)}")


def check_cell_path(path: Path) -> None:
    """Refuse what is no folder or file of a cell; what has another format than JSON and YAML passes.

    Raises:
        BadInput: There is nothing, or something else.
        OSError: It cannot be read.
    """
    check_given(path, FileKind.CELL)
    if path.is_dir():
        return
    content, is_yaml = path.read_bytes(), path.suffix.lower() in YAML_SUFFIXES
    try:
        read = parse_yaml(content)[0] if is_yaml else parse_json(content)
    except (NotJson, NotYaml):
        return
    refuse_other(read, str(path), FileKind.CELL)


def read_given(named: str, wanted: FileKind) -> bytes:
    """Return what is in a file.

    Raises:
        BadInput: As `check_given` says.
        OSError: It cannot be read.
    """
    path = Path(named)
    check_given(path, wanted)
    return path.read_bytes()


def check_given(path: Path, wanted: FileKind) -> None:
    """Refuse what is not there, and a folder unless it may be a cell.

    Raises:
        BadInput: It says what may be meant.
    """
    if path.is_dir() and wanted is not FileKind.CELL:
        raise BadInput(f"{path} is a folder; {wanted.value} is one file")
    if not path.exists():
        raise BadInput(f"{path}: there is no such file{_meant(path, wanted)}")


def _meant(path: Path, wanted: FileKind) -> str:
    task = assets_folder() / "tasks" / f"{path.name.removesuffix('.json')}.json"
    if wanted is FileKind.TASK and task.is_file():
        return f"; the task that is shipped under this name is {task}"
    cell = path.name
    if wanted is FileKind.CELL and (assets_folder() / "cells" / f"{cell}.yaml").is_file():
        return f'; that cell is shipped: `liftwright cell show {cell}` says what it can do, tasks name it as "cell"'
    return nearest(str(path), map(str, path.parent.iterdir())) if path.parent.is_dir() else ""
