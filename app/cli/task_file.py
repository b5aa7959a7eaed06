"""Files of tasks, JSON or YAML, and what is wrong with them that can be told without planning."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self

from pydantic import ValidationError

from app.cli.given_file import YAML_SUFFIXES, FileKind, read_given, refuse_other
from app.cli.output import BadInput, Refused
from planners.cell.needed_hands import FOR_LIFT, FOR_TOOL, check_shipped
from planners.contract.problems import problems_of
from planners.contract.strict_json import NotJson, parse_json
from planners.contract.strict_yaml import NotYaml, parse_yaml
from planners.contract.task_spec import read_task
from planners.errors import SceneError

STDIN = "-"


@dataclass(frozen=True)
class TaskFile:
    """What may be a task, as somebody wrote it."""

    named: str
    """As on the command line."""
    task: Any
    """JSON data."""
    lines: Mapping[str, int] = field(default_factory=dict)
    """By JSON pointer, where members stand in YAML."""

    @classmethod
    def read(cls, named: str) -> Self:
        """Read a file, or standard input, which is YAML unless it begins as a JSON object does.

        Raises:
            BadInput: It is neither, or not there, or what another command or the service takes or has written.
            OSError: It cannot be read.
        """
        path, lines = Path(named), {}
        content = sys.stdin.buffer.read() if named == STDIN else read_given(named, FileKind.TASK)
        is_yaml = path.suffix.lower() in YAML_SUFFIXES or (named == STDIN and not content.lstrip().startswith(b"{"))
        called = "standard input" if named == STDIN else named
        try:
            if is_yaml:
                task, lines = parse_yaml(content)
            else:
                task = parse_json(content, "the file")
        except (NotJson, NotYaml) as error:
            raise BadInput(f"{called}: {error}") from error
        refuse_other(task, called, FileKind.TASK)
        return cls(named, task, lines)

    @property
    def stem(self) -> str:
        """Its name without folder and ending."""
        return "stdin" if self.named == STDIN else Path(self.named).stem

    def check(self) -> None:
        """Refuse what is no task, or in no shipped cell, before anything is loaded that plans: people wait for this.

        What takes its objects from a scene that a service keeps is not complete yet, and is not looked at.

        Raises:
            Refused: It is none.
        """
        if isinstance(self.task, dict) and self.task.get("kind") == "suction_tool":
            objects = self.task.get("objects")
            detects = isinstance(objects, list) and any(isinstance(one, dict) and "detection" in one for one in objects)
            if detects or "scene_id" in self.task:
                return
        try:
            task = read_task(self.task)
            check_shipped(task.cell, FOR_LIFT if task.kind == "plate_lift" else FOR_TOOL)
        except (ValidationError, SceneError) as error:
            raise Refused(problems_of(error)) from error

    def line_of(self, pointer: str) -> int | None:
        """Return where a member stands, or what it is missing in; None where lines are not known."""
        while pointer not in self.lines and pointer:
            pointer = pointer.rpartition("/")[0]
        return self.lines.get(pointer)
