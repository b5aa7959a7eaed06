"""The worker's side of solver processes: each job has one to itself, and one waits warm for the next.

A process that has planned ends. One that has proven a task infeasible has searched for nothing, and takes further jobs
until its successor is ready: otherwise each of many such tasks would wait for a start that takes far longer than they.
"""

from __future__ import annotations

import asyncio
import json
import os
import resource
import signal
from collections import deque
from collections.abc import Awaitable, Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Self

import structlog

from planners.errors import LiftwrightError
from planners.progress import Report
from workers.solver.protocol import MAX_LINE, DocumentHeader, Message, SolverRequest, StudyRequest
from workers.stores.plan_store import PackedDocument

READY_SECONDS = 300.0
"""A child that is not ready after this long will never be [s]; one that has to compile takes a minute."""

START_PAUSES_SECONDS = (0.5, 2.0)
"""A machine that is short of memory or processes is given so long before a start is tried again [s]."""

OnReport = Callable[[Report], Awaitable[None]]
OnPoint = Callable[[dict[str, object]], Awaitable[None]]
log = structlog.get_logger(__name__)


class SolverDied(LiftwrightError):
    """A solver process gave no answer, or there could not even be one. Another one may do better."""

    @classmethod
    def with_code(cls, return_code: int) -> Self:
        """Of a process that has ended."""
        ending = f"signal {signal.Signals(-return_code).name}" if return_code < 0 else f"exit code {return_code}"
        return cls(f"the solver process ended without an answer ({ending})")


class SolverFault(LiftwrightError):
    """The solver says that it cannot give a document, and why. Asking again gives the same."""


@dataclass(frozen=True)
class SolverCommand:
    """How a solver process is started."""

    words: tuple[str, ...]
    environment: Mapping[str, str]
    """On top of the worker's own."""
    memory_bytes: int | None = None
    """So much it, and each process it starts, may take for data; None: as much as there is."""
    niceness: int = 0
    """Added to the worker's own, for it and each process it starts."""


class SolverProcess:
    """One child in a process group of its own, and in the worker's session: the kernel weighs niceness within one."""

    def __init__(self, process: asyncio.subprocess.Process) -> None:
        assert process.stdin is not None
        assert process.stdout is not None
        self._process, self._stdin, self._stdout = process, process.stdin, process.stdout
        self._ready = False
        self.again = False
        """Whether it has answered, and waits for another request."""

    @classmethod
    async def start(cls, command: SolverCommand) -> Self:
        """Start a child; it gets ready on its own.

        Raises:
            SolverDied: The machine has no process or no memory for it, or there is no such program.
        """
        try:
            process = await asyncio.create_subprocess_exec(
                *command.words,
                env={**os.environ, **command.environment},
                stdin=asyncio.subprocess.PIPE,
                stdout=asyncio.subprocess.PIPE,
                process_group=0,
                limit=MAX_LINE,
            )
        except OSError as error:
            raise SolverDied(f"the solver process could not be started ({error.strerror})") from error
        # It may have ended already; then there is nothing to limit.
        with suppress(ProcessLookupError):
            os.setpriority(os.PRIO_PROCESS, process.pid, os.getpriority(os.PRIO_PROCESS, 0) + command.niceness)
            if command.memory_bytes is not None:
                resource.prlimit(process.pid, resource.RLIMIT_DATA, (command.memory_bytes, command.memory_bytes))
        return cls(process)

    @property
    def pid(self) -> int:
        """The process id, which is also that of its group."""
        return self._process.pid

    @property
    def alive(self) -> bool:
        """Whether it has not ended yet."""
        return self._process.returncode is None

    async def ready(self) -> None:
        """Wait until it has loaded everything.

        Raises:
            SolverDied: It ended instead.
            SolverFault: It says why it cannot work.
        """
        if not self._ready:
            await self._receive()
            self._ready = True

    async def solve(self, request: SolverRequest, on_report: OnReport) -> PackedDocument:
        """Hand over a request and wait for its document. Unless it is to be asked again, the process ends by itself.

        Raises:
            SolverDied: It ended before.
            SolverFault: It says why there is none.
        """
        await self.ready()
        self.again = False
        await self._send(request)
        while True:
            message = await self._receive()
            if "progress" in message:
                await on_report(Report(*message["progress"]))
            elif "document" in message:
                return await self._receive_document(message["document"])

    async def examine(self, request: StudyRequest, on_point: OnPoint) -> None:
        """Hand over a request and wait until all of its points were passed on; the process can be asked again.

        Raises:
            SolverDied: It ended before.
            SolverFault: It says why it cannot go on.
        """
        await self.ready()
        await self._send(request)
        while True:
            message = await self._receive()
            if "point" in message:
                await on_point(message["point"])
            elif "examined" in message:
                return

    async def _send(self, request: SolverRequest | StudyRequest) -> None:
        try:
            self._stdin.write(json.dumps(request).encode() + b"\n")
            await self._stdin.drain()
        except ConnectionError:
            raise SolverDied.with_code(await self._process.wait()) from None

    async def kill(self) -> None:
        """End the whole process group now, and wait for it."""
        # The whole group may have ended already.
        with suppress(ProcessLookupError):
            os.killpg(self.pid, signal.SIGKILL)
        self._stdin.close()
        await self._process.wait()

    async def _receive(self) -> Message:
        try:
            line = await self._stdout.readline()
        except ValueError:
            raise SolverFault(f"the solver sent a line of more than {MAX_LINE} bytes") from None
        if not line.endswith(b"\n"):
            raise SolverDied.with_code(await self._process.wait())
        try:
            message: Message | None = json.loads(line)
        except ValueError:
            message = None
        if not isinstance(message, dict):
            # Last words of what runs under it, rather than of the solver.
            raise SolverDied("the solver process sent what is no message")
        if "fault" in message:
            raise SolverFault(message["fault"])
        return message

    async def _receive_document(self, header: DocumentHeader) -> PackedDocument:
        try:
            packed = await self._stdout.readexactly(header["size"])
        except asyncio.IncompleteReadError:
            raise SolverDied.with_code(await self._process.wait()) from None
        self.again = header.get("again", False)
        return PackedDocument(header["outcome"], header["sha256"], packed, header["stages"])


class SolverPool:
    """Keeps one waiting child per slot, so that a job does not wait for imports and compiled kernels."""

    def __init__(self, command: SolverCommand, slots: int) -> None:
        self._command, self._slots = command, slots
        self._waiting: deque[asyncio.Task[SolverProcess | None]] = deque()
        """One per slot, oldest first; the result is None if the child failed to get ready."""
        self._again: list[SolverProcess] = []
        """Children that have answered and take further jobs, at most as many as waiting ones are not ready yet."""
        self._ending: set[asyncio.Task[None]] = set()
        """Of such children, whose successors have become ready."""

    async def open(self) -> None:
        """Start the waiting children and wait until they are ready, or have failed to be."""
        for _ in range(self._slots):
            self._start_one()
        await asyncio.wait(self._waiting)

    async def close(self) -> None:
        """End all waiting children."""
        waiting = list(self._waiting)
        self._waiting.clear()
        self._end_surplus()
        await asyncio.gather(*map(_give_up, waiting), *self._ending)

    async def solve(self, request: SolverRequest, on_report: OnReport) -> PackedDocument:
        """Solve one request in a process that works on nothing else; when this is cancelled, the process is gone.

        Raises:
            SolverDied: The process ended before.
            SolverFault: The solver says why there is no document.
        """
        child = await self._take()
        try:
            return await child.solve(request, on_report)
        finally:
            if child.again and len(self._again) < self._unready:
                self._again.append(child)
            else:
                await child.kill()

    @property
    def _unready(self) -> int:
        """How many of the waiting children are not ready yet."""
        return sum(not each.done() for each in self._waiting)

    async def _take(self) -> SolverProcess:
        """Return the child that has waited longest, and have its successor get ready while it works."""
        while self._again:
            # Its successor was started when it was taken first.
            child = self._again.pop()
            if child.alive:
                return child
            await child.kill()
        oldest = self._waiting.popleft()
        self._start_one()
        try:
            child = await asyncio.shield(oldest)
        except asyncio.CancelledError:
            await _give_up(oldest)
            raise
        if child is not None and child.alive:
            return child
        # It failed while nobody looked: one that this job starts itself tells the job what is wrong.
        if child is not None:
            await child.kill()
        return await self._start_despite_shortage()

    async def _start_despite_shortage(self) -> SolverProcess:
        for pause in START_PAUSES_SECONDS:
            try:
                return await SolverProcess.start(self._command)
            except SolverDied as death:
                log.warning("solver not started", error=str(death), again_in_seconds=pause)
            await asyncio.sleep(pause)
        return await SolverProcess.start(self._command)

    def _start_one(self) -> None:
        starting = asyncio.create_task(self._get_ready())
        starting.add_done_callback(self._end_surplus)
        self._waiting.append(starting)

    def _end_surplus(self, _: object = None) -> None:
        """End children that have answered and have a successor that is ready, or failed to be."""
        while len(self._again) > self._unready:
            ending = asyncio.create_task(self._again.pop().kill())
            ending.add_done_callback(self._ending.discard)
            self._ending.add(ending)

    async def _get_ready(self) -> SolverProcess | None:
        try:
            child = await SolverProcess.start(self._command)
        except SolverDied:
            return None
        try:
            async with asyncio.timeout(READY_SECONDS):
                await child.ready()
        except (SolverDied, SolverFault, TimeoutError):
            await child.kill()
            return None
        except asyncio.CancelledError:
            await child.kill()
            raise
        return child


async def _give_up(waiting: asyncio.Task[SolverProcess | None]) -> None:
    """End a child, whether it is ready or not."""
    waiting.cancel()
    await asyncio.wait([waiting])
    child = None if waiting.cancelled() else waiting.result()
    if child is not None:
        await child.kill()
