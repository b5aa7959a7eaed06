"""Many workers of a fleet without solvers: real engines, a process each, forked from one that has loaded them.

A worker's queue polling, locks, proof of life, takeover, housekeeping, events and documents are those of the product;
only what a child process would answer is made up here: each job takes `JOB_SECONDS` and has a small document.

Run as a program with the number of workers; its environment has their settings, and standard output is told the ids of
their processes. It ends, and they do, when its standard input does.
"""

from __future__ import annotations

import asyncio
import gzip
import hashlib
import json
import os
import signal
import sys
import time
from typing import Self

import workers.engine.worker
from app.logs import set_up_logs
from app.serve import _work  # pyright: ignore[reportPrivateUsage]
from planners.progress import Report
from workers.settings import WorkerSettings
from workers.solver.pool import OnCertified, OnReport
from workers.solver.protocol import SolverRequest
from workers.stores.plan_store import PackedDocument

JOB_SECONDS = 0.1
STEPS = 2
"""Reports of each job."""
START_PAUSE_SECONDS = 0.1
"""Between the starts of two workers [s]."""


class MadeUpPool:
    """Stands in for `SolverPool`, without a process."""

    def __init__(self, slots: int) -> None:
        self._slots = slots

    @classmethod
    def of(cls, settings: WorkerSettings) -> Self:
        """Return the pool of a worker."""
        return cls(settings.worker_slots)

    def open(self) -> None:
        """Start nothing."""

    async def loaded(self) -> int:
        """Return that everything is ready."""
        return self._slots

    async def close(self) -> None:
        """End nothing."""

    async def solve(
        self,
        request: SolverRequest,
        on_report: OnReport,
        most_seconds: float | None = None,
        on_certified: OnCertified | None = None,
    ) -> PackedDocument:
        """Report some progress, and return a small document."""
        del most_seconds, on_certified
        for step in range(STEPS):
            await on_report(Report("motion", step + 1, STEPS))
            await asyncio.sleep(JOB_SECONDS / STEPS)
        body = json.dumps({"schema_version": "1.0", "id": request.id, "outcome": "solved"}).encode()
        return PackedDocument("solved", hashlib.sha256(body).hexdigest(), gzip.compress(body))


def main() -> None:
    """Fork the workers, and end them with this process."""
    set_up_logs()
    workers.engine.worker.SolverPool = MadeUpPool  # pyright: ignore[reportAttributeAccessIssue]
    children = []
    for number in range(int(sys.argv[1])):
        child = os.fork()
        if not child:
            _be_worker(number)
        children.append(child)
        time.sleep(START_PAUSE_SECONDS)
    sys.stdout.write(f"{json.dumps(children)}\n")
    sys.stdout.flush()
    sys.stdin.read()
    for child in children:
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)


def _be_worker(number: int) -> None:
    try:
        # Neither holds up the end of this program, nor speaks for it.
        os.dup2(os.open(os.devnull, os.O_RDWR), 0)
        os.dup2(2, 1)
        base = WorkerSettings()
        own = {"worker_name": f"w{number:04}", "data_dir": base.data_dir / f"w{number:04}"}
        asyncio.run(_work(base.model_copy(update=own)))
    finally:
        os._exit(1)


if __name__ == "__main__":
    main()
