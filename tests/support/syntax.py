"""Python source as tests look at it."""

from __future__ import annotations

import ast

from planners.contract.strict_model import parsed


def syntax_tree(text: str) -> ast.Module:
    """Return the syntax tree of a source, whatever threads other tests have left."""
    return parsed(lambda: ast.parse(text))
