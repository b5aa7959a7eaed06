"""`liftwright serve`, `api` or `worker` in a process of its own, of which a run of tests starts dozens.

Most of a start is reading modules. So a run has one process that has read them and forks for each program, as the
service does for its jobs; programs that plan are started as a person starts them with `--all`. What a program is given
and does, its signals, children and exit code are the same both ways.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import subprocess
import sys
from collections.abc import Mapping, Sequence
from functools import cache
from multiprocessing.context import ForkServerContext
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Protocol

ROOT = Path(__file__).resolve().parents[2]
COMMAND_LINE = "app.cli.main"
LOADED = "tests.support.loaded"
"""What the process that forks imports."""


class Program(Protocol):
    """As much of `subprocess.Popen` as tests need."""

    pid: int

    def poll(self) -> int | None:
        """Return the exit code, if it has ended."""
        ...

    def wait(self, timeout: float | None = None) -> int:
        """Wait for the end, and return the exit code."""
        ...

    def send_signal(self, sig: int) -> None:
        """Send a signal, unless it has ended."""
        ...


def launch(
    words: Sequence[str],
    settings: Mapping[str, str],
    *,
    told: Path | None = None,
    module: str = COMMAND_LINE,
    fresh: bool = False,
) -> Program:
    """Start `liftwright` with these words.

    Args:
        words: the command and its options.
        settings: variables of its environment besides those of this process.
        told: a file to which all is added that it writes; where this process writes to if None.
        module: what is run in its place; always in a process that has read nothing before.
        fresh: start it as a person does, because what it is told comes before some module is read, or to see that.
    """
    environment = {**os.environ, **settings}
    if fresh or module != COMMAND_LINE:
        command = [sys.executable, "-m", module, *words]
        if told is None:
            return subprocess.Popen(command, cwd=ROOT, env=environment)
        with told.open("ab") as file:
            return subprocess.Popen(command, cwd=ROOT, env=environment, stdout=file, stderr=file)
    process = _forks().Process(target=_run, args=(list(words), environment, told), daemon=True)
    process.start()
    return _Fork(process)


class _Fork:
    def __init__(self, process: BaseProcess) -> None:
        assert process.pid is not None
        self.pid, self._process = process.pid, process

    def poll(self) -> int | None:
        return self._process.exitcode

    def wait(self, timeout: float | None = None) -> int:
        self._process.join(timeout)
        code = self.poll()
        if code is None:
            self._process.kill()
            raise TimeoutError(f"process {self.pid} has not ended within {timeout} s")
        return code

    def send_signal(self, sig: int) -> None:
        if self.poll() is None:
            os.kill(self.pid, sig)


@cache
def _forks() -> ForkServerContext:
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload([LOADED])
    return context


def _run(words: list[str], environment: dict[str, str], told: Path | None) -> None:
    """Be the program."""
    # As in a process of its own, which Ctrl-C reaches.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    os.environ.clear()
    os.environ.update(environment)
    os.chdir(ROOT)
    if told is not None:
        with told.open("ab") as file:
            os.dup2(file.fileno(), 1)
            os.dup2(file.fileno(), 2)
    from app.cli.main import main

    sys.exit(main(words))
