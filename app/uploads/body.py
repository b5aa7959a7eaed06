"""The bytes of a request: no more than are let in, and no longer than is waited for."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from typing import Protocol

from starlette.requests import ClientDisconnect, Request

from app.errors import BodyStalled, BodyTooLarge, EncodedBody, NotJsonMedia

DRAINED_BYTES = 32_000_000
"""So much of a body that is refused is still taken off the wire, so that the sender gets to read the answer."""


class Patience(Protocol):
    """How long the parts of a body are waited for."""

    @property
    def body_stall_seconds(self) -> float:
        """For the next part [s]."""
        ...

    @property
    def body_seconds(self) -> float:
        """For all of it [s]."""
        ...


async def read_body(request: Request, limit: int, patience: Patience) -> bytes:
    """Return the body of a JSON request.

    Raises:
        NotJsonMedia: It is declared as something else.
        EncodedBody: It is declared as compressed.
        BodyTooLarge: It has more than `limit` bytes; the rest is not kept.
    """
    media_type = request.headers.get("content-type")
    if media_type is None or media_type.split(";")[0].strip().lower() != "application/json":
        raise NotJsonMedia(media_type)
    return await read_limited(request, limit, patience)


async def read_limited(request: Request, limit: int, patience: Patience) -> bytes:
    """Return the body of a request, whatever it is.

    Raises:
        EncodedBody: It is declared as compressed.
        BodyTooLarge: It has more than `limit` bytes; the rest is not kept.
        BodyStalled: Its sender is slower than `patience` allows.
    """
    coding = request.headers.get("content-encoding", "identity")
    if coding.strip().lower() != "identity":
        raise EncodedBody(coding)
    if _not_worth_reading(request, limit):
        raise BodyTooLarge(limit)
    body = bytearray()
    stream = _patient(request, patience)
    async for chunk in stream:
        body += chunk
        if len(body) > limit:
            break
    else:
        return bytes(body)
    del body
    try:
        drained = 0
        async for chunk in stream:
            drained += len(chunk)
            if drained > DRAINED_BYTES:
                break
    except ClientDisconnect:
        pass  # It did not want to know.
    raise BodyTooLarge(limit)


async def _patient(request: Request, patience: Patience) -> AsyncIterator[bytes]:
    """Yield a body as it comes, as long as it comes."""
    stream = aiter(request.stream())
    loop = asyncio.get_running_loop()
    deadline = loop.time() + patience.body_seconds
    while True:
        try:
            async with asyncio.timeout_at(min(loop.time() + patience.body_stall_seconds, deadline)):
                chunk = await anext(stream)
        except StopAsyncIteration:
            return
        except TimeoutError:
            raise BodyStalled(patience.body_stall_seconds) from None
        yield chunk


def _not_worth_reading(request: Request, limit: int) -> bool:
    """Whether a body is declared as too large, and its sender waits for a word first or would send for ages."""
    declared = request.headers.get("content-length", "")
    size = int(declared) if declared.isdecimal() else 0
    waits = request.headers.get("expect", "").lower() == "100-continue"
    return size > (limit if waits else limit + DRAINED_BYTES)
