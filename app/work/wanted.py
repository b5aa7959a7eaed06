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


class _Turn:
    """The turn of some work that waits for it in another thread: it is taken once, or given up before."""

    def __init__(self) -> None:
        self._lock, self._taken, self._given_up = threading.Lock(), False, False

    def take(self) -> None:
        """Begin to work.

        Raises:
            NobodyWaits: It was given up.
        """
        with self._lock:
            if self._given_up:
                raise NobodyWaits
            self._taken = True

    def give_up(self) -> bool:
        """Have nothing begun any more; tell whether that was in time."""
        with self._lock:
            self._given_up = not self._taken
            return self._given_up


async def left(request: Request) -> None:
    """Return once whoever has sent a request, all of which was read, is gone."""
    while (await request.receive())["type"] != "http.disconnect":
        pass


async def while_waited_for(request: Request, work: Callable[[StillWanted], Worked], limiter: CapacityLimiter) -> Worked:
    """Return what some work returns, done in a thread for as long as whoever has sent a request waits.

    Raises:
        ClientDisconnect: They have gone; nothing works any more.
    """
    turn = _Turn()

    def begin(wanted: StillWanted) -> Worked:
        turn.take()
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
                if turn.give_up():
                    working.cancel()
                # Whoever works needs the pipe to its end, and takes a place of the limiter as long.
                with CancelScope(shield=True):
                    await asyncio.wait([working])
                if not working.cancelled():
                    working.exception()
