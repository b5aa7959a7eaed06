"""Keeps the work in the background going: what goes wrong once must not end it for good, and must not pass unseen."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Awaitable, Callable

import structlog

from workers.stores.database_loss import DATABASE_GONE, said_by

FIRST_RETRY_SECONDS = 1.0
LONGEST_RETRY_SECONDS = 5.0
STUCK_SECONDS = 30.0
"""Work that has failed for so long without once going well does not get on [s]."""

Work = Callable[[], Awaitable[object]]
log = structlog.get_logger(__name__)


class Supervisor:
    """Has pieces of work done again and again on the running event loop, each with pauses of its own."""

    def __init__(self) -> None:
        self._tasks: dict[str, asyncio.Task[None]] = {}
        self._failing_since: dict[str, float] = {}

    def repeat(self, name: str, work: Work, pause_seconds: float, *, at_once: bool = False) -> None:
        """Begin to have some work done every so often: for the first time after the first pause, or at once.

        Work that fails is logged and tried again after a second, and then ever more slowly, down to every five seconds.
        """
        assert name not in self._tasks
        first_pause = 0.0 if at_once else pause_seconds
        self._tasks[name] = asyncio.create_task(self._repeat(name, work, first_pause, pause_seconds))

    @property
    def stuck(self) -> list[str]:
        """What does not get on. A database that is away is waited for: that does not count."""
        now = time.monotonic()
        long = {name for name, since in self._failing_since.items() if now - since >= STUCK_SECONDS}
        return [name for name, task in self._tasks.items() if task.done() or name in long]

    async def stop(self) -> None:
        """End all work."""
        tasks = list(self._tasks.values())
        self._tasks.clear()
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)

    async def _repeat(self, name: str, work: Work, first_pause: float, pause: float) -> None:
        await asyncio.sleep(first_pause)
        retry = FIRST_RETRY_SECONDS
        while True:
            if await self._goes_well(name, work):
                retry = FIRST_RETRY_SECONDS
                await asyncio.sleep(pause)
            else:
                await asyncio.sleep(retry)
                retry = min(2.0 * retry, LONGEST_RETRY_SECONDS)

    async def _goes_well(self, name: str, work: Work) -> bool:
        try:
            await work()
        except DATABASE_GONE as error:
            log.warning("waiting for the database", work=name, error=said_by(error))
            self._failing_since.pop(name, None)
            return False
        except Exception:
            # Everything is caught, as nowhere else in the background. Nobody waits for this work, so nobody would see
            # what ends it: jobs would go on being accepted while none expires, is told or is taken over any more.
            log.exception("background work failed", work=name)
            self._failing_since.setdefault(name, time.monotonic())
            return False
        self._failing_since.pop(name, None)
        return True
