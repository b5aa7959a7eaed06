"""`liftwright worker` in a process of its own."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any, Self

import psutil

from .service import ROOT, STARTUP_SECONDS, wait_for

READY = b'"event": "working"'


class WorkerProcess:
    """One worker of a fleet."""

    def __init__(self, name: str, data_dir: Path, solver: tuple[str, ...] | None, **settings: Any) -> None:
        self.name = name
        self._data_dir = data_dir
        self._environment = {f"LIFTWRIGHT_{key.upper()}": str(value) for key, value in settings.items()}
        if solver is not None:
            self._environment["LIFTWRIGHT_SOLVER_COMMAND"] = json.dumps(solver)
        self._log = data_dir / f"{name}.log"
        self.process: subprocess.Popen[bytes] | None = None

    @property
    def log(self) -> str:
        """What its lives have written."""
        return self._log.read_text() if self._log.exists() else ""

    def launch(self) -> None:
        """Start it."""
        self._data_dir.mkdir(parents=True, exist_ok=True)
        words = ["worker", "--worker-name", self.name, "--data-dir", str(self._data_dir)]
        with self._log.open("ab") as told:
            self.process = subprocess.Popen(
                [sys.executable, "-m", "app.cli", *words],
                cwd=ROOT, env={**os.environ, **self._environment}, stderr=told, stdout=told,
            )  # fmt: skip

    def start(self) -> Self:
        """Start, and wait until it takes jobs."""
        before = self.log.count(READY.decode())
        self.launch()
        wait_for(lambda: self._works(before), STARTUP_SECONDS)
        return self

    def solvers(self) -> list[psutil.Process]:
        """Its solver processes, oldest first."""
        assert self.process is not None
        children = psutil.Process(self.process.pid).children(recursive=True)
        return sorted(children, key=lambda process: process.create_time())

    def end(self, number: signal.Signals) -> None:
        """Send a signal, and wait for the end."""
        if self.process is not None:
            self.process.send_signal(number)
            self.process.wait(timeout=60)
            self.process = None

    def _works(self, before: int) -> bool:
        assert self.process is not None
        assert self.process.poll() is None, f"the worker ended instead of getting ready: {self.log[-2000:]}"
        return self.log.count(READY.decode()) > before
