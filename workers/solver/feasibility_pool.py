"""The service's side of live feasibility: a process for each of some editors, which keeps the graph of its lift."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass, field

import structlog

from planners.plan.verdicts import Feasibility
from workers.solver.pool import SolverCommand, SolverDied, SolverFault, SolverProcess
from workers.solver.protocol import FeasibilityRequest

log = structlog.get_logger(__name__)


@dataclass(eq=False)
class _Keeper:
    """A process, and the editor whose lift it keeps."""

    editor: str
    process: SolverProcess
    turn: asyncio.Lock = field(default_factory=asyncio.Lock)


class FeasibilityPool:
    """Gives a process to each editor that asks, as long as there are not too many. On one event loop."""

    def __init__(self, command: SolverCommand, most: int) -> None:
        """Start none yet.

        Args:
            command: how one is started.
            most: so many there are at most [1]; of a further editor the one that asked longest ago makes room.
        """
        self._command, self._most = command, most
        self._keepers: dict[str, _Keeper] = {}
        """By editor; the one that asked last is the last."""
        self._entry = asyncio.Lock()

    async def ask(self, editor: str, request: FeasibilityRequest) -> Feasibility | None:
        """Say whether a lift has a way left; None where nothing is known: all processes are busy, or this one failed.

        Args:
            editor: who asks; one question at a time.
            request: of the lift.
        """
        keeper = await self._keeper_of(editor)
        if keeper is None:
            return None
        async with keeper.turn:
            try:
                return await keeper.process.judge(request)
            except (SolverDied, SolverFault) as error:
                log.warning("feasibility not told", error=str(error))
                await self._end(keeper)
                return None
            except asyncio.CancelledError:
                # What it answers now would be taken for the answer to another question.
                await self._end(keeper)
                raise

    async def leave(self, editor: str) -> None:
        """End the process of an editor that is closed."""
        keeper = self._keepers.get(editor)
        if keeper is not None:
            await self._end(keeper)

    async def close(self) -> None:
        """End all processes."""
        for keeper in [*self._keepers.values()]:
            await self._end(keeper)

    async def _keeper_of(self, editor: str) -> _Keeper | None:
        async with self._entry:
            keeper = self._keepers.pop(editor, None)
            if keeper is not None and not keeper.process.alive:
                # Whatever it has started goes with it.
                await self._end(keeper)
                keeper = None
            if keeper is None:
                if not await self._makes_room():
                    return None
                try:
                    keeper = _Keeper(editor, await SolverProcess.start(self._command))
                except SolverDied as error:
                    log.warning("feasibility not told", error=str(error))
                    return None
            self._keepers[editor] = keeper
            return keeper

    async def _makes_room(self) -> bool:
        """End the idle process whose editor asked longest ago, if there are too many; False where all are busy."""
        if len(self._keepers) < self._most:
            return True
        idle = next((each for each in self._keepers.values() if not each.turn.locked()), None)
        if idle is None:
            return False
        await self._end(idle)
        return True

    async def _end(self, keeper: _Keeper) -> None:
        if self._keepers.get(keeper.editor) is keeper:
            del self._keepers[keeper.editor]
        await keeper.process.kill()
