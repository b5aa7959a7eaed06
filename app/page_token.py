"""Where the next page of a list begins, as text that clients hand back without looking into it."""

from __future__ import annotations

import base64
import re

from app.errors import BadHeader

_POSITION = re.compile(rb"(\d{1,18})-([0-9a-f]{32})")


def write_page_token(position: tuple[int, str]) -> str:
    """Return the token of the plan with (created_us, id) = `position`."""
    created_us, plan_id = position
    return base64.urlsafe_b64encode(f"{created_us}-{plan_id}".encode()).decode().rstrip("=")


def read_page_token(token: str) -> tuple[int, str]:
    """Return what `write_page_token` was given.

    Raises:
        BadHeader: It never wrote this.
    """
    try:
        text = base64.urlsafe_b64decode(token + "=" * (-len(token) % 4))
    except ValueError:
        text = b""
    match = _POSITION.fullmatch(text)
    if match is None:
        raise BadHeader("page_token is not one this service gave")
    return int(match[1]), match[2].decode()
