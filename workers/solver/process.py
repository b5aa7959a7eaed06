"""The child's side: one process that waits for a task, solves it, hands the document over, and ends.

Only where the task was proven infeasible, which takes no search and leaves nothing behind, it waits for another one.
It has a process group of its own. When its stdin closes the worker has died, and the whole group kills itself.
"""

from __future__ import annotations

import gc
import gzip
import hashlib
import json
import os
import resource
import signal
import sys
import threading
import time
import traceback
from collections.abc import Callable
from pathlib import Path
from queue import SimpleQueue
from types import TracebackType
from typing import TYPE_CHECKING, BinaryIO, Self

from planners.errors import LiftwrightError
from planners.progress import Progress, Report
from workers.solver.protocol import HANDOVERS_VARIABLE, Answer, DocumentHeader, Message, SolverRequest

if TYPE_CHECKING:
    from workers.solver.pipeline import Pipeline

REPORT_SECONDS = 0.05
"""Least time between two reports of stages that have begun [s]: reports must not slow the work down."""
COMPILE = "--compile"
"""Argument with which the process only compiles what is not compiled yet of the parts that follow."""
PARTS = ("plate_lift", "suction_tool")
"""Kinds of tasks whose kernels can be compiled apart."""
GZIP_LEVEL = 3
"""Documents shrink to a fifth at this level in about a tenth of the time of the highest one."""

Solve = Callable[[SolverRequest, Progress], Answer]
"""Answers a request, telling its progress."""


class Channel:
    """The way back to the worker. What libraries print goes to stderr instead."""

    def __init__(self) -> None:
        self._stream: BinaryIO = os.fdopen(os.dup(1), "wb")
        os.dup2(2, 1)

    def send(self, message: Message, block: bytes = b"") -> None:
        """Send one line and the bytes that follow it."""
        try:
            self._stream.write(json.dumps(message).encode() + b"\n" + block)
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
        self._channel.send({"progress": report})


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
        traceback.print_exception(kind, error, trace)
        self._channel.send({"fault": _sentence(error)})
        return True


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
    """Get ready and solve what is requested, until something was searched for."""
    channel = Channel()
    requests = listen_to_the_worker()
    with ReportedFaults(channel):
        solve = prepare()
        tell_ready(channel)
        while _answer(solve, json.loads(requests.get()), channel):
            gc.collect()


def tell_ready(channel: Channel) -> None:
    """Say that everything is loaded."""
    # What is loaded stays: to look through all of it for garbage would cost the job a tenth of a second at a time.
    gc.collect()
    gc.freeze()
    channel.send({"ready": True})


def _answer(solve: Solve, request: SolverRequest, channel: Channel) -> bool:
    """Hand over the document of a request; return whether there may be another one."""
    answer = solve(request, ThrottledReports(channel))
    packed = gzip.compress(answer.document, GZIP_LEVEL, mtime=0)
    header: DocumentHeader = {
        "outcome": answer.outcome,
        "sha256": hashlib.sha256(answer.document).hexdigest(),
        "size": len(packed),
        "stages": list(answer.stages),
        "again": (again := answer.outcome == "infeasible"),
    }
    channel.send({"document": header}, packed)
    return again


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
