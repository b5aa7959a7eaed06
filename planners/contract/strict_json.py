"""From bytes to JSON data, taking only what RFC 8259 calls JSON and every reader understands in the same way."""

from __future__ import annotations

import json
from typing import Any

from planners.errors import LiftwrightError


class NotJson(LiftwrightError):
    """A body is not JSON; the message is a sentence for a person."""


def parse_json(body: bytes, called: str = "the body") -> Any:
    """Parse `body`, which messages call as its reader does. A byte order mark, as Windows writes one, is skipped.

    Raises:
        NotJson: Not UTF-8, not JSON, a literal NaN or Infinity, a key twice in one object, an escape that is half
            of a surrogate pair, an integer of thousands of digits, or nesting beyond what can be read.
    """
    try:
        text = body.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise NotJson(f"{called} is not UTF-8: byte {error.start} cannot be decoded") from error
    try:
        data = json.loads(text, object_pairs_hook=_object_of_unique_keys, parse_constant=_refuse_constant)
    except json.JSONDecodeError as error:
        raise NotJson(f"{called} is not JSON: {error.msg} (line {error.lineno}, column {error.colno})") from error
    except RecursionError as error:
        raise NotJson(f"{called} is nested too deeply") from error
    except ValueError as error:
        raise NotJson(f"{called} has a number with too many digits") from error
    if "\\u" in text:
        _refuse_lone_surrogates(data)
    return data


def _object_of_unique_keys(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    members = dict(pairs)
    if len(members) == len(pairs):
        return members
    seen: set[str] = set()
    for key, _ in pairs:
        if key in seen:
            raise NotJson(f"the key {key[:100]!r} stands twice in one object")
        seen.add(key)
    return members


def _refuse_constant(literal: str) -> float:
    raise NotJson(f"{literal} is not JSON")


def _refuse_lone_surrogates(data: Any) -> None:
    """Python reads half a surrogate pair, but no text can be written with it."""
    try:
        json.dumps(data, ensure_ascii=False).encode("utf-8")
    except UnicodeEncodeError as error:
        raise NotJson("a string has half of a surrogate pair") from error
