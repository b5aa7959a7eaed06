"""The second opinion is one only if it does not ask the first."""

from __future__ import annotations

import ast
from pathlib import Path

import planners.certify

SHARED = ("planners.certify", "planners.errors", "planners.geometry.pose")


def test_nothing_is_imported_from_the_planners_but_transforms_and_errors() -> None:
    for path in Path(str(planners.certify.__file__)).parent.glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            names = [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            names += [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            assert all(name.startswith(SHARED) for name in names if name.split(".")[0] == "planners"), path.name
