"""The tasks that come with the service, to be sent as they are or changed."""

from __future__ import annotations

import json
from importlib import resources


def example_tasks() -> dict[str, list[str]]:
    """Return the names of the shipped tasks, files `assets/tasks/NAME.json`, by kind."""
    names: dict[str, list[str]] = {}
    for path in sorted(resources.files("assets").joinpath("tasks").iterdir(), key=lambda path: path.name):
        if path.name.endswith(".json"):
            names.setdefault(json.loads(path.read_text())["kind"], []).append(path.name.removesuffix(".json"))
    return names
