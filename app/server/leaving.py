"""A server that stops: who waits in a request for what may take long gets an answer then, and a stream ends."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterable, AsyncIterator, Awaitable
from typing import TypeVar

from starlette.types import Scope

EXTENSION = "liftwright.leaving"
"""Of ASGI, in the scope of each request: an event that is set as soon as the server stops."""
Waited = TypeVar("Waited")


def leaving_of(scope: Scope) -> asyncio.Event:
    """Return the event that a request's server sets when it stops; one that never is set where it has none."""
    return scope.get("extensions", {}).get(EXTENSION) or asyncio.Event()


async def unless_leaving(leaving: asyncio.Event, waited: Awaitable[Waited]) -> Waited | None:
    """Wait for something, until the server stops at the latest; None: it does, and what was waited for is cancelled."""
    asked, left = asyncio.ensure_future(waited), asyncio.ensure_future(leaving.wait())
    try:
        await asyncio.wait((asked, left), return_when=asyncio.FIRST_COMPLETED)
        return asked.result() if asked.done() else None
    finally:
        asked.cancel()
        left.cancel()
        await asyncio.gather(asked, left, return_exceptions=True)


async def until_leaving(leaving: asyncio.Event, pieces: AsyncIterable[Waited]) -> AsyncIterator[Waited]:
    """Yield the pieces of a stream until the server stops."""
    coming = aiter(pieces)
    while True:
        try:
            piece = await unless_leaving(leaving, anext(coming))
        except StopAsyncIteration:
            return
        if piece is None:
            return
        yield piece
