"""The child's side: one process that has everything loaded, and forks another one for each task.

The fork solves the task, hands the document over, and ends; what it leaves behind ends with it. It costs milliseconds
where a start takes seconds, and nothing of a task is there when the next one is begun. No thread lives at the fork, for
what one of them was doing would never be done in the fork.
The process leads a process group, to which its forks belong. When its stdin closes the worker has died, and the whole
group is killed; the kernel kills a fork whose parent has died.
"""

from __future__ import annotations

import ctypes
import gc
import gzip
import hashlib
import json
import os
import resource
import select
import signal
import sys
import threading
import time
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from pathlib import Path
from queue import SimpleQueue
from types import TracebackType
from typing import TYPE_CHECKING, BinaryIO, Self

from planners.errors import LiftwrightError
from planners.progress import Progress, Report
from workers.loading import loading
from workers.solver.protocol import HANDOVERS_VARIABLE, Answer, DocumentHeader, Message, SolverRequest

if TYPE_CHECKING:
    from workers.solver.pipeline import Pipeline

REPORT_SECONDS = 0.05
"""Least time between two reports of stages that have begun [s]: reports must not slow the work down."""
THREAD_END_SECONDS = 1.0
"""So long a thread that has done its work may take to be gone [s]."""
COMPILE = "--compile"
"""Argument with which the process only compiles what is not compiled yet of the parts that follow."""
PARTS = ("plate_lift", "suction_tool")
"""Kinds of tasks whose kernels can be compiled apart."""
GZIP_LEVEL = 3
"""Documents shrink to a fifth at this level in about a tenth of the time of the highest one."""

Solve = Callable[[SolverRequest, Progress, Callable[[Answer], bool]], Answer]
"""Answers a request, telling its progress, and its answer as soon as that is certified, if more is to be added to it;
what is told of that says whether to stop there."""


class ThreadsAlive(LiftwrightError):
    """A process is to fork that has threads, of which the fork would have none."""


class Channel:
    """The way back to the worker. What libraries print goes to stderr instead."""

    def __init__(self) -> None:
        self._stream: BinaryIO = os.fdopen(os.dup(1), "wb")
        os.dup2(2, 1)

    def send(self, message: Message, block: bytes = b"") -> None:
        """Send one line and the bytes that follow it."""
        try:
            self._stream.write(message.line() + block)
            self._stream.flush()
        except BrokenPipeError:
            _die_with_the_worker()


class ThrottledReports:
    """Progress callback: passes on what is new enough to be worth a line."""

    def __init__(self, channel: Channel, clock: Callable[[], float] = time.monotonic) -> None:
        self._channel, self._clock = channel, clock
        self._begun: set[str] = set()
        self._next = 0.0

    def __call__(self, report: Report, /) -> None:
        """Report when a stage begins for the first time and when it ends, otherwise at most every `REPORT_SECONDS`."""
        now = self._clock()
        if report.name in self._begun and report.done != report.total and now < self._next:
            return
        self._begun.add(report.name)
        self._next = now + REPORT_SECONDS
        self._channel.send(Message(progress=report))


class ReportedFaults:
    """Context in which an exception ends the job with a sentence instead of leaving the worker to guess."""

    def __init__(self, channel: Channel) -> None:
        self._channel = channel

    def __enter__(self) -> Self:
        """Enter."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> bool:
        """Report an error that is not the interpreter's own way to end; its traceback goes to stderr."""
        if not isinstance(error, Exception):
            return False
        _log(error)
        self._channel.send(Message(fault=_sentence(error)))
        return True


def _log(error: Exception) -> None:
    """Write an error to stderr as the worker writes its own: an object a line, unless a person reads them."""
    told = "".join(traceback.format_exception(error))
    if not sys.stderr.isatty():
        now = datetime.now(UTC).isoformat().replace("+00:00", "Z")
        event = {"exception": told.rstrip(), "event": "a solver met an error", "level": "error", "timestamp": now}
        told = json.dumps(event) + "\n"
    # One write: other processes have the same stderr.
    os.write(sys.stderr.fileno(), told.encode(errors="replace"))


def _sentence(error: Exception) -> str:
    if isinstance(error, LiftwrightError):
        return str(error)
    if isinstance(error, MemoryError):
        return f"the task needs more memory than a solver may take{_memory_limit()}"
    return f"the solver met an error of its own: {type(error).__name__}: {error}"


def _memory_limit() -> str:
    limit, _ = resource.getrlimit(resource.RLIMIT_DATA)
    return "" if limit == resource.RLIM_INFINITY else f" ({limit // 2**20} MiB, LIFTWRIGHT_SOLVER_MEMORY_MB)"


def main(prepare: Callable[[], Solve]) -> None:
    """Get ready, and have a fork solve each task that is requested."""
    channel = Channel()
    with ReportedFaults(channel):
        with _dying_with_the_worker(), loading():
            solve = prepare()
            # What it took to get ready is done with, and would be kept.
            gc.collect()
        _adopt_orphans()
        channel.send(Message(ready=True))
        for request in _requests():
            status = _forked(lambda task=request: _answer_one(solve, task, channel))
            if status != 0:
                # The worker sees an end without an answer, as it was.
                _end_as(status)
            channel.send(Message(ready=True))


def _answer_one(solve: Solve, request: bytes, channel: Channel) -> None:
    with ReportedFaults(channel):
        _answer(solve, SolverRequest.read(request), channel)


def _forked(work: Callable[[], None]) -> int:
    """Have a fork of this process do some work, and return its wait status when it and all it has started are gone."""
    require_one_thread()
    parent = os.getpid()
    child = os.fork()
    if child == 0:
        _die_with(parent)
        code = 1
        with suppress(BaseException):
            work()
            code = 0
        os._exit(code)
    ended = os.pidfd_open(child)
    try:
        poll = select.poll()
        poll.register(ended, select.POLLIN)
        # That the other end is closed is told unasked; nobody writes there meanwhile.
        poll.register(sys.stdin.fileno(), 0)
        if any(descriptor != ended for descriptor, _ in poll.poll()):
            _die_with_the_worker()
    finally:
        os.close(ended)
    _, status = os.waitpid(child, 0)
    _end_orphans()
    return status


def require_one_thread() -> None:
    """Wait a moment for threads that end.

    Raises:
        ThreadsAlive: This process has more than one for longer.
    """
    deadline = time.monotonic() + THREAD_END_SECONDS
    while (alive := len(os.listdir("/proc/self/task"))) > 1:
        if time.monotonic() > deadline:
            named = ", ".join(thread.name for thread in threading.enumerate())
            raise ThreadsAlive(f"{alive} threads live in a process that is to fork (of Python's: {named})")
        time.sleep(0.001)


def _end_orphans() -> None:
    """Kill whatever a fork has started and left behind, and what that has left behind."""
    with suppress(ChildProcessError):
        while True:
            os.waitpid(-1, os.WNOHANG)
            for orphan in Path(f"/proc/self/task/{os.getpid()}/children").read_text().split():
                os.kill(int(orphan), signal.SIGKILL)
                os.waitpid(int(orphan), 0)


def _adopt_orphans() -> None:
    """Have what a fork leaves behind be this process's child (prctl(2), PR_SET_CHILD_SUBREAPER)."""
    _prctl(36, 1)


def _die_with(parent: int) -> None:
    """Have the kernel kill this process when its parent dies (prctl(2), PR_SET_PDEATHSIG)."""
    _prctl(1, signal.SIGKILL)
    if os.getppid() != parent:
        os._exit(1)


def _prctl(option: int, value: int) -> None:
    if ctypes.CDLL(None, use_errno=True).prctl(option, ctypes.c_ulong(value), 0, 0, 0) != 0:
        raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))


def _end_as(status: int) -> None:
    """End by the signal, or with the exit code, by which a fork has ended."""
    if os.WIFSIGNALED(status):
        number = os.WTERMSIG(status)
        # No core of this process: it is none of its faults.
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        with suppress(OSError):
            signal.signal(number, signal.SIG_DFL)
        os.kill(os.getpid(), number)
    os._exit(os.waitstatus_to_exitcode(status) % 256)


def _requests() -> Iterator[bytes]:
    """Yield the lines of stdin; end when the worker is gone."""
    line = bytearray()
    while chunk := os.read(sys.stdin.fileno(), 65536):
        line += chunk
        if line.endswith(b"\n"):
            yield bytes(line)
            line.clear()


@contextmanager
def _dying_with_the_worker() -> Iterator[None]:
    """Kill the group if stdin closes meanwhile, whatever is going on; nothing is read, and no thread is left after."""
    read, write = os.pipe()

    def watch() -> None:
        poll = select.poll()
        # That the other end is closed is told unasked.
        poll.register(sys.stdin.fileno(), 0)
        poll.register(read, 0)
        if any(descriptor != read for descriptor, _ in poll.poll()):
            _die_with_the_worker()

    watcher = threading.Thread(target=watch, daemon=True)
    watcher.start()
    try:
        yield
    finally:
        os.close(write)
        watcher.join()
        os.close(read)


def _answer(solve: Solve, request: SolverRequest, channel: Channel) -> None:
    """Hand over the document of a request."""
    ended = False

    def send_certified(answer: Answer) -> bool:
        nonlocal ended
        header, packed = _packed(answer)
        channel.send(Message(certified=header), packed)
        ended = request.until_certified
        return ended

    answer = solve(request, ThrottledReports(channel), send_certified)
    if not ended:
        header, packed = _packed(answer)
        channel.send(Message(document=header), packed)


def _packed(answer: Answer) -> tuple[DocumentHeader, bytes]:
    packed = gzip.compress(answer.document, GZIP_LEVEL, mtime=0)
    sha256 = hashlib.sha256(answer.document).hexdigest()
    return DocumentHeader(answer.outcome, sha256, len(packed), answer.stages, answer.physics), packed


def answer_each(prepare: Callable[[], Callable[[bytes, Channel], None]]) -> None:
    """Get ready, and answer requests one after the other in this process, for what it knows from one to the next."""
    channel = Channel()
    requests = listen_to_the_worker()
    with ReportedFaults(channel):
        with loading():
            answer = prepare()
            # What it took to get ready is done with, and would be kept.
            gc.collect()
        channel.send(Message(ready=True))
        while True:
            answer(requests.get(), channel)


def listen_to_the_worker() -> SimpleQueue[bytes]:
    """Return where requests will be, each of which follows the answer to the last; end when the worker is gone."""
    requests: SimpleQueue[bytes] = SimpleQueue()
    threading.Thread(target=_listen, args=(requests,), daemon=True).start()
    return requests


def _listen(requests: SimpleQueue[bytes]) -> None:
    line = bytearray()
    while chunk := os.read(sys.stdin.fileno(), 65536):
        line += chunk
        if line.endswith(b"\n"):
            requests.put(bytes(line))
            line.clear()
    _die_with_the_worker()


def _die_with_the_worker() -> None:
    leads_its_group = os.getpgrp() == os.getpid()
    os.kill(-os.getpid() if leads_its_group else os.getpid(), signal.SIGKILL)


def load_pipeline() -> Pipeline:
    """Return what this process solves with, for a worker that says where it keeps handovers."""
    # Here, because it takes a second in which the worker may die; and a solver of another make, as tests use it,
    # needs the rest of this file without the planners.
    from workers.solver.pipeline import Pipeline

    folder = os.environ.get(HANDOVERS_VARIABLE)
    return Pipeline.load(Path(folder) if folder else None)


if __name__ == "__main__":
    if COMPILE in sys.argv:
        listen_to_the_worker()
        load_pipeline().compile(*sys.argv[sys.argv.index(COMPILE) + 1 :])
    else:
        main(lambda: load_pipeline().warm_up().answer)
