"""`liftwright worker` in a process of its own."""

from __future__ import annotations

import json
import signal
from pathlib import Path
from typing import Any, Self

import psutil

from .program import COMMAND_LINE, Program, launch
from .service import STARTUP_SECONDS, call_warm, wait_for

READY = b'"event": "working"'


class WorkerProcess:
    """One worker of a fleet."""

    def __init__(
        self,
        name: str,
        data_dir: Path,
        solver: tuple[str, ...] | None,
        *,
        module: str = COMMAND_LINE,
        fresh: bool = False,
        **settings: Any,
    ) -> None:
        """Take what `program.launch` is to be told."""
        self.name, self._module, self._fresh = name, module, fresh
        self.data_dir = data_dir
        self._environment = {f"LIFTWRIGHT_{key.upper()}": str(value) for key, value in settings.items()}
        if solver is not None:
            self._environment["LIFTWRIGHT_SOLVER_COMMAND"] = json.dumps(solver)
        self._solver = solver
        self._log = data_dir / f"{name}.log"
        self._lives = 0
        """How often it has become ready before."""
        self.process: Program | None = None

    @property
    def log(self) -> str:
        """What its lives have written."""
        return self._log.read_text() if self._log.exists() else ""

    def launch(self) -> None:
        """Start it."""
        self.data_dir.mkdir(parents=True, exist_ok=True)
        words = ["worker", "--worker-name", self.name, "--data-dir", str(self.data_dir)]
        self._lives = self.log.count(READY.decode())
        if self._solver is not None:
            call_warm(self.data_dir, self._solver)
        self.process = launch(words, self._environment, told=self._log, module=self._module, fresh=self._fresh)

    def start(self) -> Self:
        """Start, and wait until it takes jobs."""
        self.launch()
        self.wait()
        return self

    def wait(self) -> None:
        """Wait until it takes jobs."""
        wait_for(self._works, STARTUP_SECONDS)

    def solvers(self) -> list[psutil.Process]:
        """Its solver processes, oldest first."""
        assert self.process is not None
        children = psutil.Process(self.process.pid).children(recursive=True)
        return sorted(children, key=lambda process: process.create_time())

    def end(self, number: signal.Signals) -> None:
        """Send a signal, and wait for the end."""
        if self.process is not None:
            self.process.send_signal(number)
            code = self.process.wait(timeout=120)
            self.process = None
            expected = 0 if number is signal.SIGTERM else -number
            assert code == expected, f"the worker ended with {code} and not {expected}: {self.log[-2000:]}"

    def _works(self) -> bool:
        assert self.process is not None
        assert self.process.poll() is None, f"the worker ended instead of getting ready: {self.log[-2000:]}"
        return self.log.count(READY.decode()) > self._lives
