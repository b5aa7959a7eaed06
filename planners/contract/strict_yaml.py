"""From bytes of YAML to JSON data, and where in the text each member stands.

Scalars are those of YAML 1.2's core schema: what looks like a number in JSON is one (1e-3 too), and words like "no" or
"on" are strings.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import yaml

from planners.contract.problems import json_pointer
from planners.errors import LiftwrightError

MOST_NODES = 100_000
"""A text of more, or whose aliases make more of it, is no task [1]."""
_TAG = "tag:yaml.org,2002:"
_SCALARS = {
    "null": re.compile(r"(?:~|null|Null|NULL|)\Z"),
    "bool": re.compile(r"(?:true|True|TRUE|false|False|FALSE)\Z"),
    "int": re.compile(r"[-+]?[0-9]{1,4000}\Z"),
    "float": re.compile(r"[-+]?(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?\Z"),
}


class NotYaml(LiftwrightError):
    """A text is not YAML, or not such YAML as JSON could say; the message is a sentence for a person."""


class _CoreLoader(yaml.SafeLoader):
    """Knows the scalars of YAML 1.2 only."""


_CoreLoader.yaml_implicit_resolvers = dict[str, list[tuple[str, re.Pattern[str]]]]()
for _name, _pattern in _SCALARS.items():
    _CoreLoader.add_implicit_resolver(_TAG + _name, _pattern, None)


def parse_yaml(body: bytes) -> tuple[Any, Mapping[str, int]]:
    """Parse a file.

    Returns:
        JSON data, and by JSON pointer (RFC 6901) the line, from 1, in which a member stands.

    Raises:
        NotYaml: Not UTF-8, not YAML, more than one document, a tag, a key that is no string or stands twice in one
            mapping, an alias of what it is itself part of, or far too much.
    """
    try:
        text = body.decode("utf-8-sig")
        root = yaml.compose(text, Loader=_CoreLoader)
        reader = _NodeReader()
        return reader.value(root, ()), reader.lines
    except UnicodeDecodeError as error:
        raise NotYaml(f"the file is not UTF-8: byte {error.start} cannot be decoded") from error
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        where = "" if mark is None else f" (line {mark.line + 1}, column {mark.column + 1})"
        raise NotYaml(f"the file is not YAML: {error.problem or error.context}{where}") from error
    except yaml.YAMLError as error:
        raise NotYaml(f"the file is not YAML: {error}") from error
    except RecursionError as error:
        raise NotYaml("the file is nested too deeply") from error


class _NodeReader:
    """Reads the nodes of one text."""

    def __init__(self) -> None:
        self.lines: dict[str, int] = {}
        self._nodes = 0
        self._open: list[yaml.Node] = []

    def value(self, node: yaml.Node | None, path: tuple[str | int, ...]) -> Any:
        """Return what a node says, at a path of keys and indices."""
        if node is None:
            return None
        self._nodes += 1
        if self._nodes > MOST_NODES:
            raise NotYaml(f"the file has more than {MOST_NODES} values")
        if any(node is each for each in self._open):
            raise self._fault(node, "an alias stands for what it is itself part of")
        self.lines.setdefault(json_pointer(path), node.start_mark.line + 1)
        self._open.append(node)
        try:
            return self._read(node, path)
        finally:
            self._open.pop()

    def _read(self, node: yaml.Node, path: tuple[str | int, ...]) -> Any:
        if isinstance(node, yaml.MappingNode) and node.tag == f"{_TAG}map":
            return self._mapping(node, path)
        if isinstance(node, yaml.SequenceNode) and node.tag == f"{_TAG}seq":
            return [self.value(each, (*path, place)) for place, each in enumerate(node.value)]
        text = node.value
        match node.tag.removeprefix(_TAG):
            case "str":
                return self._text(node)
            case "null":
                return None
            case "bool":
                return text.lower() == "true"
            case "int" if _SCALARS["int"].match(text):
                return int(text)
            case "float" if _SCALARS["float"].match(text):
                return float(text)
            case _:
                raise self._fault(node, f"the tag {node.tag.removeprefix(_TAG)!r} is not known here")

    def _mapping(self, node: yaml.MappingNode, path: tuple[str | int, ...]) -> dict[str, Any]:
        members: dict[str, Any] = {}
        for key, value in node.value:
            if not isinstance(key, yaml.ScalarNode) or key.tag != f"{_TAG}str":
                raise self._fault(key, "a key is no string")
            name = self._text(key)
            if name in members:
                raise self._fault(key, f"the key {name[:100]!r} stands twice in one mapping")
            here = (*path, name)
            self.lines[json_pointer(here)] = key.start_mark.line + 1
            members[name] = self.value(value, here)
        return members

    def _text(self, node: yaml.Node) -> str:
        """Return a string in which pairs of escapes, as JSON writes them, are one character."""
        try:
            return node.value.encode("utf-16", "surrogatepass").decode("utf-16")
        except UnicodeDecodeError as error:
            raise self._fault(node, "a string has half of a surrogate pair") from error

    def _fault(self, node: yaml.Node, why: str) -> NotYaml:
        return NotYaml(f"the file, line {node.start_mark.line + 1}: {why}")
