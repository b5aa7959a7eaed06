"""The worker's side of processes that examine points of studies: kept from part to part, for what they remember."""

from __future__ import annotations

import asyncio

from workers.solver.pool import OnPoint, SolverCommand, SolverProcess
from workers.solver.protocol import StudyRequest

IDLE_SECONDS = 15.0
"""So long a process waits for another part of a study before it ends [s]."""


class ExaminerPool:
    """Starts a process for each part that is worked on at the same time, and keeps it for the next."""

    def __init__(self, command: SolverCommand) -> None:
        self._command = command
        self._idle: dict[SolverProcess, asyncio.Task[None]] = {}
        """With what ends each when nobody has asked for it."""

    async def examine(self, request: StudyRequest, on_point: OnPoint) -> None:
        """Have a process examine points; when this is cancelled, or something is wrong, the process is gone.

        Raises:
            SolverDied: The process ended before, or could not be started.
            SolverFault: It says why it cannot go on.
        """
        child = await self._take()
        try:
            await child.examine(request, on_point)
        except BaseException:
            await child.kill()
            raise
        self._idle[child] = asyncio.create_task(self._end_later(child))

    async def close(self) -> None:
        """End all processes that wait."""
        while self._idle:
            child, ending = self._idle.popitem()
            ending.cancel()
            await child.kill()

    async def _take(self) -> SolverProcess:
        while self._idle:
            # The last one that worked knows most of what is asked next.
            child, ending = self._idle.popitem()
            ending.cancel()
            if child.alive:
                return child
            await child.kill()
        return await SolverProcess.start_patiently(self._command)

    async def _end_later(self, child: SolverProcess) -> None:
        await asyncio.sleep(IDLE_SECONDS)
        del self._idle[child]
        await child.kill()
