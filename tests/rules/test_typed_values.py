"""What the product passes on are typed values; dicts of anything are for JSON of others, where it comes in."""

from __future__ import annotations

import ast
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from functools import cache
from pathlib import Path

import pytest

from tests.support.syntax import nodes_of, syntax_tree

ROOT = Path(__file__).resolve().parents[2]
PRODUCT = ("app", "planners", "workers")
MAPPINGS = {"dict", "Mapping", "MutableMapping"}
TYPES = {"Literal", "Annotated", "Future"}
"""Whose brackets hold no key."""


def name_of(node: ast.expr) -> str | None:
    return node.id if isinstance(node, ast.Name) else node.attr if isinstance(node, ast.Attribute) else None


def is_of_anything(node: ast.AST) -> bool:
    """Tell whether an annotation is dict[…, Any] or Mapping[…, Any]."""
    return (
        isinstance(node, ast.Subscript)
        and name_of(node.value) in MAPPINGS
        and isinstance(node.slice, ast.Tuple)
        and name_of(node.slice.elts[-1]) == "Any"
    )


def signatures_of_anything(nodes: Iterable[ast.AST]) -> Iterator[int]:
    """Yield the lines of functions that take or return a mapping of anything."""
    for node in nodes:
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            given = [*ast.walk(node.args), *([] if node.returns is None else ast.walk(node.returns))]
            if any(map(is_of_anything, given)):
                yield node.lineno


def literal_keys(nodes: Iterable[ast.AST]) -> Iterator[int]:
    """Yield the lines at which something is looked up by a literal key."""
    for node in nodes:
        if (
            isinstance(node, ast.Subscript)
            and isinstance(node.ctx, ast.Load)
            and isinstance(node.slice, ast.Constant)
            and isinstance(node.slice.value, str)
            and name_of(node.value) not in TYPES
        ):
            yield node.lineno


@cache
def product() -> list[tuple[str, tuple[ast.AST, ...]]]:
    """Return the nodes of every module of the product, with the folder that it is counted in."""
    paths = [path for folder in PRODUCT for path in (ROOT / folder).rglob("*.py")]
    return [("/".join(path.relative_to(ROOT).parts[:2]), nodes_of(path)) for path in paths]


@pytest.mark.parametrize(("found", "most"), [(signatures_of_anything, 60), (literal_keys, 200)])
def test_few_places_take_dicts_of_anything(found: Callable[[Iterable[ast.AST]], Iterator[int]], most: int) -> None:
    counts = Counter[str]()
    for folder, nodes in product():
        counts[folder] += len(list(found(nodes)))
    assert counts.total() <= most, f"{counts.total()}, of which {dict((+counts).most_common())}"


@pytest.mark.parametrize(
    ("text", "signatures", "keys"),
    [
        ("def read(body: dict[str, Any]) -> Plan: ...", 1, 0),
        ("async def read(bodies: list[Mapping[str, typing.Any]]) -> None: ...", 1, 0),
        ("def read(body: bytes) -> dict[str, float]: ...", 0, 0),
        ("speed = limits['speed'] + limits[name]; limits['speed'] = 0.0", 0, 1),
        ("kind: Literal['box']", 0, 0),
    ],
)
def test_both_are_counted(text: str, signatures: int, keys: int) -> None:
    nodes = [*ast.walk(syntax_tree(text))]
    assert (len(list(signatures_of_anything(nodes))), len(list(literal_keys(nodes)))) == (signatures, keys)
