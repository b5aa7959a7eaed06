"""The worker's side of solver processes: one for each slot, which has a fork of its own work on each job."""

from __future__ import annotations

import asyncio
import os
import resource
import signal
from collections import deque
from collections.abc import Awaitable, Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Self

import structlog

from planners.errors import LiftwrightError
from planners.plan.verdicts import Feasibility
from planners.progress import Report
from workers.settings import WorkerSettings
from workers.solver.protocol import (
    HANDOVERS_VARIABLE,
    MAX_LINE,
    REJECTED_VARIABLE,
    AnyRequest,
    DocumentHeader,
    FeasibilityRequest,
    Message,
    SolverRequest,
    StudyRequest,
)
from workers.stores.plan_store import PackedDocument

REJECTED_FOLDER = "rejected"
"""Below the data directory: where documents are kept that failed their certificate."""

READY_SECONDS = 300.0
"""A child that is not ready after this long will never be [s]; one that has to compile takes a minute."""

GONE_SECONDS = 5.0
"""So long it is waited for forks of a process that was killed [s]."""

START_PAUSES_SECONDS = (0.5, 2.0)
"""A machine that is short of memory or processes is given so long before a start is tried again [s]."""

ONE_THREAD = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
"""Libraries of linear algebra keep threads otherwise, which a process that forks must not have."""

SESSION_TRIES = 20
"""How often the weight of a solver's session is set, a tenth of a second apart [1]."""

LOADING = Report("load", 0, 0)
"""A job waits for a solver that is still loading."""

OnReport = Callable[[Report], Awaitable[None]]
OnCertified = Callable[[PackedDocument], Awaitable[None]]
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

    @classmethod
    def of(cls, settings: WorkerSettings, words: tuple[str, ...], nicer: int = 0) -> Self:
        """Return how a worker starts a process that plans; `nicer` is how much further it stands back than solvers."""
        rejected = settings.data_dir.resolve() / REJECTED_FOLDER
        folders = {REJECTED_VARIABLE: str(rejected), HANDOVERS_VARIABLE: str(settings.handovers_dir)}
        return cls(words, folders, settings.solver_memory_mb * 2**20, min(19, settings.solver_niceness + nicer))


async def _weigh_session(leader: int, niceness: int) -> None:
    """Weigh a session among others as a process of that niceness among others of one session (sched(7), autogroups)."""
    autogroup = Path(f"/proc/{leader}/autogroup")
    for _ in range(SESSION_TRIES):
        try:
            autogroup.write_text(str(niceness))
        except BlockingIOError:
            # Without privileges, one session of the whole machine in a tenth of a second.
            await asyncio.sleep(0.1)
        except OSError:
            # It has ended, or there are no autogroups: niceness counts among all processes, or all of the container.
            return
        else:
            return
    log.warning("a solver does not stand back behind other sessions", process=leader)


class SolverProcess:
    """One child in a session of its own, which stands back behind all others as the child does within one."""

    def __init__(self, process: asyncio.subprocess.Process) -> None:
        assert process.stdin is not None
        assert process.stdout is not None
        self._process, self._stdin, self._stdout = process, process.stdin, process.stdout
        self._ready = False

    @classmethod
    async def start(cls, command: SolverCommand) -> Self:
        """Start a child; it gets ready on its own.

        Raises:
            SolverDied: The machine has no process or no memory for it, or there is no such program.
        """
        try:
            process = await asyncio.create_subprocess_exec(
                *command.words,
                env={**os.environ, **ONE_THREAD, **command.environment},
                stdin=asyncio.subprocess.PIPE,
                stdout=asyncio.subprocess.PIPE,
                start_new_session=True,
                limit=MAX_LINE,
            )
        except OSError as error:
            raise SolverDied(f"the solver process could not be started ({error.strerror})") from error
        solver = cls(process)
        try:
            # It may have ended already; then there is nothing to limit.
            with suppress(ProcessLookupError):
                niceness = min(19, os.getpriority(os.PRIO_PROCESS, 0) + command.niceness)
                os.setpriority(os.PRIO_PROCESS, process.pid, niceness)
                if command.memory_bytes is not None:
                    resource.prlimit(process.pid, resource.RLIMIT_DATA, (command.memory_bytes, command.memory_bytes))
                await _weigh_session(process.pid, niceness)
        except BaseException:
            await solver.kill()
            raise
        return solver

    @classmethod
    async def start_patiently(cls, command: SolverCommand) -> Self:
        """Start a child; a machine that is short of processes or memory is given some time.

        Raises:
            SolverDied: It is short of them still, or there is no such program.
        """
        for pause in START_PAUSES_SECONDS:
            try:
                return await cls.start(command)
            except SolverDied as death:
                log.warning("solver not started", error=str(death), again_in_seconds=pause)
            await asyncio.sleep(pause)
        return await cls.start(command)

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

    async def solve(
        self, request: SolverRequest, on_report: OnReport, on_certified: OnCertified | None = None
    ) -> PackedDocument:
        """Hand over a request and wait for its document; then, or after a fault, the process gets ready again.

        `on_certified` is given the document before, as soon as it is certified, if more is added to it after that.
        Where the request says `until_certified` that document is returned, as one that is not complete.

        Raises:
            SolverDied: It ended before.
            SolverFault: It says why there is none.
        """
        await self.ready()
        self._ready = False
        await self._send(request)
        while True:
            message = await self._receive()
            if message.progress is not None:
                await on_report(message.progress)
            elif message.certified is not None:
                certified = await self._receive_document(message.certified)
                if request.until_certified:
                    return replace(certified, complete=False)
                if on_certified is not None:
                    await on_certified(certified)
            elif message.document is not None:
                return await self._receive_document(message.document)

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
            if message.point is not None:
                await on_point(message.point)
            elif message.examined:
                return

    async def judge(self, request: FeasibilityRequest) -> Feasibility | None:
        """Ask whether a lift has a way left; None where nothing is known. The process can be asked again.

        Raises:
            SolverDied: It ended before.
            SolverFault: It says why it cannot go on.
        """
        await self.ready()
        await self._send(request)
        while (found := (await self._receive()).feasibility) is None:
            pass
        return Feasibility(*found) if found else None

    async def _send(self, request: AnyRequest) -> None:
        try:
            self._stdin.write(request.line())
            await self._stdin.drain()
        except ConnectionError:
            raise SolverDied.with_code(await self._process.wait()) from None

    async def kill(self) -> None:
        """End the whole process group now, and wait for it; who is cancelled meanwhile is so after that."""
        # The whole group may have ended already.
        with suppress(ProcessLookupError):
            os.killpg(self.pid, signal.SIGKILL)
        self._stdin.close()
        cancelled: asyncio.CancelledError | None = None
        while True:
            try:
                await self._gone()
                break
            except asyncio.CancelledError as again:
                # A job that is left may be left again, or the service stopped: its process is waited for all the same.
                cancelled = again
        if cancelled is not None:
            raise cancelled

    async def _gone(self) -> None:
        """Wait until nothing is left of a process that was killed."""
        await self._process.wait()
        # A fork of it has the same stdout, and may take a moment longer to be gone.
        with suppress(TimeoutError):
            async with asyncio.timeout(GONE_SECONDS):
                while await self._stdout.read(2**16):
                    pass

    async def _receive(self) -> Message:
        try:
            line = await self._stdout.readline()
        except ValueError:
            raise SolverFault(f"the solver sent a line of more than {MAX_LINE} bytes") from None
        if not line.endswith(b"\n"):
            raise SolverDied.with_code(await self._process.wait())
        try:
            message = Message.read(line)
        except (ValueError, TypeError):
            # Last words of what runs under it, rather than of the solver.
            raise SolverDied("the solver process sent what is no message") from None
        if message.fault is not None:
            raise SolverFault(message.fault)
        return message

    async def _receive_document(self, header: DocumentHeader) -> PackedDocument:
        try:
            packed = await self._stdout.readexactly(header.size)
        except asyncio.IncompleteReadError:
            raise SolverDied.with_code(await self._process.wait()) from None
        return PackedDocument(header.outcome, header.sha256, packed, header.stages, physics=header.physics)


class SolverPool:
    """Keeps one child per slot, so that a job does not wait for imports and compiled kernels."""

    def __init__(self, command: SolverCommand, slots: int) -> None:
        self._command, self._slots = command, slots
        self._waiting: deque[asyncio.Task[SolverProcess | None]] = deque()
        """Those that do not work on a job; the result is None if the child failed to get ready."""
        self._working = 0
        """Jobs that have a child, or wait for one."""
        self._open, self._closed = False, False

    @classmethod
    def of(cls, settings: WorkerSettings) -> Self:
        """Return the pool of a worker; no child is started yet."""
        return cls(SolverCommand.of(settings, settings.solver_command), settings.worker_slots)

    def open(self) -> None:
        """Start the children, if they were not started before. A job waits for the one that is ready soonest."""
        if self._open:
            return
        self._open = True
        for _ in range(self._slots):
            self._get_ready(None)

    async def loaded(self) -> int:
        """Wait until the children are ready, or have failed to be; returns how many are ready."""
        done, _ = await asyncio.wait(self._waiting)
        return sum(not child.cancelled() and child.result() is not None for child in done)

    async def close(self) -> None:
        """End all children that wait; those that work end with their jobs."""
        self._closed = True
        waiting = list(self._waiting)
        self._waiting.clear()
        await asyncio.gather(*map(_give_up, waiting))

    async def solve(
        self,
        request: SolverRequest,
        on_report: OnReport,
        most_seconds: float | None = None,
        on_certified: OnCertified | None = None,
    ) -> PackedDocument:
        """Solve one request in a process that works on nothing else; when this is cancelled, the process is gone.

        Args:
            request: what is to be solved.
            on_report: told of progress, and at first of `LOADING` where no child is ready yet.
            most_seconds: so long the solver may take, from when it is ready [s]; None: as long as it likes.
            on_certified: given the document once it is certified, if more is added to it after that.

        Raises:
            SolverDied: The process ended before.
            SolverFault: The solver says why there is no document.
            TimeoutError: It took too long, and its process is gone.
        """
        self._working += 1
        child: SolverProcess | None = None
        answered = False
        try:
            if not any(each.done() for each in self._waiting):
                await on_report(LOADING)
            child = await self._take()
            await _wait_until_ready(child)
            async with asyncio.timeout(most_seconds):
                document = await child.solve(request, on_report, on_certified)
            answered = True
            return document
        except SolverFault:
            answered = child is not None and child.alive
            raise
        finally:
            self._working -= 1
            wanted = not self._closed and len(self._waiting) + self._working < self._slots
            try:
                if child is not None and not (answered and wanted):
                    await child.kill()
            finally:
                # It may have been closed while the process was ended; who was cancelled then leaves the slot as well.
                if wanted and not self._closed:
                    self._get_ready(child if answered else None)

    async def _take(self) -> SolverProcess:
        """Return a child that is ready, or the one that will be soonest."""
        ready = next((each for each in self._waiting if each.done()), None)
        if ready is not None:
            self._waiting.remove(ready)
        soonest = ready or (self._waiting.popleft() if self._waiting else None)
        if soonest is not None:
            try:
                child = await asyncio.shield(soonest)
            except asyncio.CancelledError:
                if self._closed:
                    await _give_up(soonest)
                else:
                    # Others may still want it.
                    self._waiting.append(soonest)
                raise
            if child is not None and child.alive:
                return child
            if child is not None:
                await child.kill()
        # It failed while nobody looked: one that this job starts itself tells the job what is wrong.
        return await SolverProcess.start_patiently(self._command)

    def _get_ready(self, child: SolverProcess | None) -> None:
        """Wait for a child that has answered, or for a new one."""
        self._waiting.append(asyncio.create_task(self._made_ready(child)))

    async def _made_ready(self, child: SolverProcess | None) -> SolverProcess | None:
        if child is not None and await _becomes_ready(child):
            return child
        try:
            child = await SolverProcess.start(self._command)
        except SolverDied:
            return None
        return child if await _becomes_ready(child) else None


async def _becomes_ready(child: SolverProcess) -> bool:
    """Wait until a child is ready; one that fails to be is gone."""
    try:
        await _wait_until_ready(child)
    except (SolverDied, SolverFault):
        await child.kill()
        return False
    except asyncio.CancelledError:
        await child.kill()
        raise
    return True


async def _wait_until_ready(child: SolverProcess) -> None:
    try:
        async with asyncio.timeout(READY_SECONDS):
            await child.ready()
    except TimeoutError:
        raise SolverDied(f"the solver process was not ready after {READY_SECONDS:g} s") from None


async def _give_up(waiting: asyncio.Task[SolverProcess | None]) -> None:
    """End a child, whether it is ready or not."""
    waiting.cancel()
    await asyncio.wait([waiting])
    child = None if waiting.cancelled() else waiting.result()
    if child is not None:
        await child.kill()
