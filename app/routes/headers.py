"""What headers of requests say, and answers that depend on them."""

from __future__ import annotations

import re

from fastapi import Response

from app.errors import BadHeader

KEY_PATTERN = r"^[\x21-\x7e]{1,255}$"


def unless_known(response: Response, if_none_match: str | None) -> Response:
    """Return an answer, or 304 if its `ETag` is among those in `If-None-Match`."""
    if if_none_match is None:
        return response
    known = {tag.strip().removeprefix("W/") for tag in if_none_match.split(",")}
    if response.headers["ETag"].removeprefix("W/") not in known and "*" not in known:
        return response
    kept = ("etag", "cache-control", "retry-after", "vary")
    return Response(status_code=304, headers={k: v for k, v in response.headers.items() if k in kept})


def read_idempotency_key(header: str | None) -> str | None:
    """Return the key of a caller, if it has one.

    Raises:
        BadHeader: It is none.
    """
    if header is None:
        return None
    key = header.strip().strip('"')
    if not re.fullmatch(KEY_PATTERN, key):
        raise BadHeader("Idempotency-Key must be 1 to 255 visible characters")
    return key


def read_event_id(header: str | None, last: int) -> int:
    """Return how many events a client has; `last` were sent at most.

    Raises:
        BadHeader: No event has that id.
    """
    if header is None:
        return 0
    if not re.fullmatch(r"\d{1,9}", header, re.ASCII) or int(header) > last:
        raise BadHeader("Last-Event-ID must be the id of an event of this stream")
    return int(header)


def read_wait(prefer: list[str]) -> int | None:
    """Return the first `wait` [s]; preferences that are not understood are ignored (RFC 7240)."""
    for preference in ",".join(prefer).split(","):
        match = re.fullmatch(r"\s*wait\s*=\s*(\"?)(\d{1,9})\1\s*(;.*)?", preference, re.IGNORECASE | re.ASCII)
        if match is not None:
            return int(match.group(2))
    return None
