"""The other side of a workbench: one process that has read the modules it was asked for, and forks for each work.

A fork costs milliseconds, where reading modules takes seconds, and must not be one of the service itself, whose other
threads may hold what they would never give back in it. What every work of a module would have to do first besides, such
as loading kernels, its function `prepare` does, if it has one, once the first work is under way. A fork ends with its
work; the kernel ends it before (SIGIO) when nobody waits for that any more, whatever it is doing.
"""

from __future__ import annotations

import fcntl
import os
import resource
import select
import signal
import socket
import sys
import traceback
from contextlib import suppress
from importlib import import_module

from app.work.protocol import (
    LENGTH_BYTES,
    LONGEST_NAME,
    WorkAnswer,
    WorkDone,
    WorkFailed,
    WorkOutgrown,
    WorkRefused,
    packed,
    unpacked,
)
from planners.errors import LiftwrightError
from workers.loading import loading
from workers.solver.process import require_one_thread

CHUNK = 1 << 20


def main(control: int, memory_bytes: int) -> None:
    """Fork for each work that comes on a socket, until the service ends."""
    _end_with(sys.stdin.fileno())
    # What libraries print is none of ours to answer.
    os.dup2(2, 1)
    # Nobody waits for forks, which end by themselves.
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)
    prepared = set[str]()
    with socket.socket(fileno=control) as works:
        while True:
            module, descriptors, _, _ = socket.recv_fds(works, LONGEST_NAME, 2)
            if not module:
                return
            name = module.decode()
            # What is wrong with it is told by the fork, which tries again.
            with suppress(Exception), loading():
                import_module(name)
            require_one_thread()
            if os.fork() == 0:
                works.close()
                job, wanted = descriptors
                _work(job, wanted, memory_bytes)
            for descriptor in descriptors:
                os.close(descriptor)
            if name not in prepared:
                prepared.add(name)
                # What is wrong here, each work finds out for itself.
                with suppress(Exception), loading():
                    prepare = getattr(import_module(name), "prepare", None)
                    if prepare is not None:
                        prepare()


def _work(job: int, wanted: int, memory_bytes: int) -> None:
    """Do one work, and end."""
    try:
        signal.signal(signal.SIGCHLD, signal.SIG_DFL)
        _end_with(wanted)
        resource.setrlimit(resource.RLIMIT_DATA, (memory_bytes, memory_bytes))
        # What takes too much memory is none of the machine's faults to be looked at.
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        with socket.socket(fileno=job) as stream:
            answer = _answer(stream)
            stream.sendall(len(answer).to_bytes(LENGTH_BYTES, "big"))
            stream.sendall(answer)
    finally:
        os._exit(0)


def _answer(stream: socket.socket) -> bytes:
    answer: WorkAnswer
    try:
        sent = bytearray()
        while chunk := stream.recv(CHUNK):
            sent += chunk
        function, arguments, named = unpacked(sent)
        del sent
        return packed(WorkDone(function(*arguments, **named)))
    except LiftwrightError as error:
        answer = WorkRefused.of(error)
    except MemoryError:
        answer = WorkOutgrown()
    except Exception as error:  # noqa: BLE001 - the service raises it again
        answer = WorkFailed(repr(error), traceback.format_exc())
    # Here, where nothing of the work is left that would take memory.
    return packed(answer)


def _end_with(descriptor: int) -> None:
    """Have the kernel end this process when the other end of a pipe, to which nobody writes, is closed."""
    signal.signal(signal.SIGIO, signal.SIG_DFL)
    fcntl.fcntl(descriptor, fcntl.F_SETOWN, os.getpid())
    fcntl.fcntl(descriptor, fcntl.F_SETFL, fcntl.fcntl(descriptor, fcntl.F_GETFL) | os.O_ASYNC)
    poll = select.poll()
    poll.register(descriptor, 0)
    if poll.poll(0):
        # It had been closed before.
        os._exit(0)


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
