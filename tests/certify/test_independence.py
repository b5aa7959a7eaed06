"""The second opinion is one only if it does not ask the first."""

from __future__ import annotations

import ast
from pathlib import Path

import planners.certify
from tests.support.syntax import syntax_tree

SHARED = ("planners.certify", "planners.contract", "planners.errors", "planners.geometry.pose", "planners.plan")
"""What a task and a plan are, and how they are read; not planning.py, which makes plans."""


def is_shared(name: str) -> bool:
    return any(name == shared or name.startswith(f"{shared}.") for shared in SHARED)


def test_nothing_is_imported_from_the_planners_but_transforms_errors_and_how_a_plan_is_read() -> None:
    for path in Path(str(planners.certify.__file__)).parent.rglob("*.py"):
        for node in ast.walk(syntax_tree(path.read_text())):
            names = [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            names += [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            assert all(is_shared(name) for name in names if name.split(".")[0] == "planners"), path.name
