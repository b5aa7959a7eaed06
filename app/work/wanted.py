"""Whether somebody still waits for some work, and how whoever works on it learns that nobody does."""

from __future__ import annotations

import asyncio
import os
import threading
from collections.abc import Callable
from types import TracebackType
from typing import Self, TypeVar

from anyio import CancelScope, CapacityLimiter, to_thread
from starlette.requests import ClientDisconnect, Request

Worked = TypeVar("Worked")


class NobodyWaits(Exception):
    """Whoever asked for some work has gone."""


class StillWanted:
    """Whether somebody still waits for some work: context manager around the wait.

    It is a pipe whose other end this process alone has: that is closed when nobody waits any more, and by the kernel
    when this process ends, however it does.
    """

    def __init__(self) -> None:
        self.descriptor, self._held = os.pipe()
        """Told of a hang-up once nobody waits."""
        self._lock, self._still = threading.Lock(), True

    def __enter__(self) -> Self:
        """Wait."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Nobody waits any more, nor works."""
        self.no_longer()
        os.close(self.descriptor)

    def no_longer(self) -> None:
        """Tell that nobody waits any more. From any thread."""
        with self._lock:
            if self._still:
                self._still = False
                os.close(self._held)


async def left(request: Request) -> None:
    """Return once whoever has sent a request, all of which was read, is gone."""
    while (await request.receive())["type"] != "http.disconnect":
        pass


async def while_waited_for(request: Request, work: Callable[[StillWanted], Worked], limiter: CapacityLimiter) -> Worked:
    """Return what some work returns, done in a thread for as long as whoever has sent a request waits.

    Raises:
        ClientDisconnect: They have gone; nothing works any more.
    """
    # Taken once, by whichever is first: the work begins, or is not to begin any more.
    turn = threading.Lock()

    def begin(wanted: StillWanted) -> Worked:
        if not turn.acquire(blocking=False):
            raise NobodyWaits
        return work(wanted)

    with StillWanted() as wanted:
        working = asyncio.ensure_future(to_thread.run_sync(begin, wanted, limiter=limiter))
        gone = asyncio.create_task(left(request))
        try:
            await asyncio.wait((working, gone), return_when=asyncio.FIRST_COMPLETED)
            if not working.done():
                raise ClientDisconnect
            return working.result()
        finally:
            gone.cancel()
            wanted.no_longer()
            if not working.done():
                if turn.acquire(blocking=False):
                    working.cancel()
                # Whoever works needs the pipe to its end, and takes a place of the limiter as long.
                with CancelScope(shield=True):
                    await asyncio.wait([working])
                if not working.cancelled():
                    working.exception()
