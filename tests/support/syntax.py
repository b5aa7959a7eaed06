"""Python source as tests look at it: each file is read once, and each of its nodes is visited once."""

from __future__ import annotations

import ast
from functools import cache
from pathlib import Path

from planners.contract.strict_model import parsed


def syntax_tree(text: str) -> ast.Module:
    """Return the syntax tree of a source, whatever threads other tests have left."""
    return parsed(lambda: ast.parse(text))


@cache
def tree_of(path: Path) -> ast.Module:
    """Return the syntax tree of a file, which nobody changes."""
    return syntax_tree(path.read_text())


@cache
def nodes_of(path: Path) -> tuple[ast.AST, ...]:
    """Return all nodes of a file, each before those that are further in."""
    return tuple(ast.walk(tree_of(path)))
