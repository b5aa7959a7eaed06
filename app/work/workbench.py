"""Where a request has something done that takes seconds, and memory that the service must not lack."""

from __future__ import annotations

import os
import select
import socket
import subprocess
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from typing import ParamSpec, TypeVar

import structlog

from app.errors import WorkDied, WorkTooLarge
from app.work.process import CHUNK
from app.work.protocol import LENGTH_BYTES, WorkAnswer, WorkDone, WorkFailed, WorkRefused, packed, unpacked
from app.work.wanted import NobodyWaits, StillWanted
from workers.solver.pool import ONE_THREAD

COMMAND = (sys.executable, "-m", "app.work.process")
log = structlog.get_logger(__name__)

Given = ParamSpec("Given")
Made = TypeVar("Made")


class WorkError(Exception):
    """Some work met an error of its own, which the log has."""


class Workbench:
    """Does each work in a process of its own: a fork of one that has read the modules that were asked for before.

    That one is started when there is something to do, and anew if it has ended.
    """

    def __init__(self, memory_bytes: int) -> None:
        """Each work may take so much for its data, what modules hold included [bytes]."""
        self._memory_bytes = memory_bytes
        self._lock = threading.Lock()
        self._forks: subprocess.Popen[bytes] | None = None
        self._works: socket.socket | None = None

    def do(
        self, wanted: StillWanted, function: Callable[Given, Made], *arguments: Given.args, **named: Given.kwargs
    ) -> Made:
        """Return what a function of some module returns, for as long as it is wanted. Blocks.

        Arguments and result are copied. What is wanted is one work at a time.

        Raises:
            NobodyWaits: It is wanted no longer, and its process is gone.
            WorkTooLarge: It took more memory than it may.
            WorkDied: Its process ended without an answer.
            LiftwrightError: As the function raised it.
            WorkError: The function raised something else.
        """
        ours, theirs = socket.socketpair()
        ours.setblocking(False)
        with ours:
            with theirs:
                self._hand_over(function.__module__, theirs, wanted)
            try:
                _send(ours, wanted, packed((function, arguments, named)))
                answer = _receive(ours, wanted)
            except ConnectionError:
                answer = None
        if answer is None:
            raise WorkDied(self._memory_bytes)
        if isinstance(answer, WorkDone):
            return answer.result
        if isinstance(answer, WorkRefused):
            raise answer.error()
        if isinstance(answer, WorkFailed):
            log.error("work failed", work=function.__qualname__, exception=answer.traceback)
            raise WorkError(answer.error)
        raise WorkTooLarge(self._memory_bytes)

    def close(self) -> None:
        """Do nothing more; works that are under way end with those who wait for them."""
        with self._lock:
            self._end()

    def _hand_over(self, module: str, job: socket.socket, wanted: StillWanted) -> None:
        descriptors = [job.fileno(), wanted.descriptor]
        with self._lock:
            for works in (self._works, None):
                try:
                    socket.send_fds(works or self._begin(), [module.encode()], descriptors)
                except ConnectionError:
                    # It has been killed, for the memory that it holds perhaps.
                    self._end()
                else:
                    return
        raise WorkDied(self._memory_bytes)

    def _begin(self) -> socket.socket:
        self._works, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with theirs:
            self._forks = subprocess.Popen(
                [*COMMAND, str(theirs.fileno()), str(self._memory_bytes)],
                env={**os.environ, **ONE_THREAD},
                # It ends with this process, as nobody else has the other end.
                stdin=subprocess.PIPE,
                pass_fds=[theirs.fileno()],
                process_group=0,
            )
        return self._works

    def _end(self) -> None:
        if self._works is not None:
            self._works.close()
        if self._forks is not None:
            assert self._forks.stdin is not None
            self._forks.stdin.close()
            self._forks.wait()
        self._works = self._forks = None


def _send(stream: socket.socket, wanted: StillWanted, content: bytes) -> None:
    left = memoryview(content)
    while left:
        _wait(stream, wanted, select.POLLOUT)
        with suppress(BlockingIOError):
            left = left[stream.send(left[:CHUNK]) :]
    stream.shutdown(socket.SHUT_WR)


def _receive(stream: socket.socket, wanted: StillWanted) -> WorkAnswer | None:
    """Return the whole answer; None: there is none."""
    came = bytearray()
    while True:
        _wait(stream, wanted, select.POLLIN)
        if not (chunk := stream.recv(CHUNK)):
            break
        came += chunk
    with memoryview(came) as seen:
        whole = len(came) >= LENGTH_BYTES and int.from_bytes(seen[:LENGTH_BYTES], "big") == len(came) - LENGTH_BYTES
    del came[:LENGTH_BYTES]
    return unpacked(came) if whole else None


def _wait(stream: socket.socket, wanted: StillWanted, event: int) -> None:
    poll = select.poll()
    poll.register(stream, event)
    # A hang-up is told unasked.
    poll.register(wanted.descriptor, 0)
    if any(descriptor == wanted.descriptor for descriptor, _ in poll.poll()):
        raise NobodyWaits
