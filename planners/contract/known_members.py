"""Which members the schema of a task knows at a place of its body."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cache
from typing import Any

from planners.contract.task_spec import UNION_TAGS, task_schema

_TAGGED = ("kind", "type")
"""Members whose constants tell the branches of unions apart."""


def known_members(location: Sequence[str | int]) -> list[str]:
    """Return the names of the members of an object, as the schema lists them; none where the schema knows no object.

    Args:
        location: of the object in a body, with the names of union branches as pydantic puts them in.
    """
    objects = list(_branches(_schema()))
    for step in location:
        if step in UNION_TAGS and not any(step in each.get("properties", {}) for each in objects):
            objects = [each for each in objects if _tag(each) == step] or objects
        else:
            objects = [branch for each in objects for below in _below(each, step) for branch in _branches(below)]
    return list(dict.fromkeys(name for each in objects for name in each.get("properties", {})))


@cache
def _schema() -> dict[str, Any]:
    return task_schema()


def _branches(schema: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """Yield a schema, or the branches of one that has several, without references."""
    if "$ref" in schema:
        yield from _branches(_schema()["$defs"][schema["$ref"].rsplit("/", 1)[-1]])
    elif several := schema.get("oneOf") or schema.get("anyOf"):
        for branch in several:
            yield from _branches(branch)
    else:
        yield schema


def _below(schema: dict[str, Any], step: str | int) -> Iterator[dict[str, Any]]:
    if isinstance(step, str):
        below = schema.get("properties", {}).get(step)
    else:
        below = schema.get("items")
    if below is not None:
        yield below


def _tag(schema: dict[str, Any]) -> str | None:
    """Return the constant by which a branch is told from the others."""
    properties = schema.get("properties", {})
    return next((properties[name].get("const") for name in _TAGGED if name in properties), None)
