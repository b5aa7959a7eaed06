"""Controllers as processes that a test starts, does things to, and reads the recorded motion of."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from .controller import Configuration

ROOT = Path(__file__).parents[3]


def hosts() -> dict[str, str]:
    """Return an address on this machine for each arm, that no other process of tests uses."""
    pid = os.getpid()
    return {arm: f"127.{64 + (pid >> 8) % 64}.{pid % 256}.{last}" for arm, last in (("left", 2), ("right", 3))}


class Recording:
    """What an arm did, a row a control cycle."""

    def __init__(self, rows: np.ndarray) -> None:
        self.time, self.q = rows[:, 0], rows[:, 1:7]
        self.step, self.barrier, self.state = (rows[:, column].astype(int) for column in (7, 8, 9))
        self.path_time, self.safety_mode, self.runtime_state = rows[:, 10], rows[:, 11], rows[:, 12]
        self.share = rows[:, 13]

    def still_since(self) -> float:
        """Return when the arm moved last [s, monotonic clock]."""
        moved = np.flatnonzero(np.abs(np.diff(self.q, axis=0)).max(axis=1) > 1e-12)
        return float(self.time[moved[-1] + 1]) if len(moved) else float(self.time[0])


class StandIn:
    """One controller's process."""

    def __init__(self, configuration: Configuration) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-m", "tests.support.controller.controller", json.dumps(asdict(configuration))],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            cwd=ROOT,
        )

    def wait_ready(self) -> None:
        assert self._process.stdout is not None
        said = self._process.stdout.readline()
        assert said == "ready\n", said

    @property
    def is_alive(self) -> bool:
        return self._process.poll() is None

    def tell(self, **order: Any) -> dict[str, Any]:
        """Do something to the controller; returns what it has said so far, and its time."""
        self.order(**order)
        return self.answer()

    def order(self, **order: Any) -> None:
        """Do something to the controller without waiting for its answer, which has to be taken next."""
        assert self._process.stdin is not None
        self._process.stdin.write(json.dumps(order) + "\n")
        self._process.stdin.flush()

    def answer(self) -> dict[str, Any]:
        assert self._process.stdout is not None
        return json.loads(self._process.stdout.readline())

    def recording(self) -> Recording:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "record.npy"
            self.tell(record=str(path))
            return Recording(np.load(path))

    def kill(self) -> None:
        self._process.kill()
        self._process.wait()

    def close(self) -> None:
        self._process.kill()
        self._process.communicate()


@contextmanager
def stand_ins(*configurations: Configuration) -> Iterator[list[StandIn]]:
    """Have a controller for each configuration, from when all are ready until the block ends."""
    started: list[StandIn] = []
    try:
        for configuration in configurations:
            started.append(StandIn(configuration))
        for controller in started:
            controller.wait_ready()
        yield started
    finally:
        for controller in started:
            controller.close()
