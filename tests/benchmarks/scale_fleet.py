"""An API with workers of its own on SQLite or PostgreSQL, with made-up solvers, and how it is looked at."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from signal import SIGKILL, SIGTERM
from typing import Any

import httpx
import psutil

from app.access.caller import Scope
from app.cli.keys_command import issue_key
from tests.support.postgres import PostgresServer, running_postgres
from tests.support.program import COMMAND_LINE
from tests.support.service import ServiceProcess
from tests.support.worker import WorkerProcess
from workers.settings import WorkerSettings

MANY = 1_000_000
UNLIMITED = {"max_queued": MANY, "max_queued_of_owner": MANY, "requests_per_second": MANY, "request_burst": MANY}
"""Settings of a service that refuses nobody because of how much is asked."""
MIB = 2**20


@dataclass(frozen=True)
class ScaleFleet:
    """A service that runs."""

    settings: WorkerSettings
    """Which lead to its database."""
    api: ServiceProcess
    """On SQLite it is the worker as well."""
    workers: Sequence[WorkerProcess]
    server: PostgresServer | None
    keys: dict[str, str]
    """By owner."""

    def client(self, owner: str) -> httpx.Client:
        """Return a client with the key of an owner."""
        headers = {"Authorization": f"Bearer {self.keys[owner]}"}
        return httpx.Client(base_url=self.api.address, headers=headers, timeout=120.0)

    def memory_mib(self) -> dict[str, float]:
        """Return what each process of the service has for itself alone, without its solvers [MiB]."""
        processes = {"API": self.api.process, **{worker.name: worker.process for worker in self.workers}}
        return {
            name: psutil.Process(process.pid).memory_full_info().uss / MIB
            for name, process in processes.items()
            if process is not None
        }


@contextmanager
def running_fleet(
    folder: Path,
    solver: tuple[str, ...],
    *,
    postgres: bool,
    owners: Sequence[str] = (),
    workers: int = 2,
    module: str = COMMAND_LINE,
    **settings: Any,
) -> Iterator[ScaleFleet]:
    """Run a service for the time of a block.

    Args:
        folder: where its files are.
        solver: the command of its solvers.
        postgres: whether the API and each worker are processes apart, on PostgreSQL; else all is one, on SQLite.
        owners: who has a key; without any, none is asked for.
        workers: how many, of one slot each; on SQLite that many slots.
        module: what is run in place of `liftwright`.
        settings: of all processes.
    """
    shared = {**UNLIMITED, **settings, "worker_slots": 1 if postgres else workers}
    with ExitStack() as stack:
        server = stack.enter_context(running_postgres()) if postgres else None
        place = {} if server is None else {"database_url": server.url}
        told = WorkerSettings.model_validate({"data_dir": folder / "api", **place})
        keys = {owner: issue_key(told, owner, Scope.WRITE, None) for owner in owners}
        # Started as people start them: what is forked shares memory, which is measured.
        own = [
            WorkerProcess(f"w{n}", folder / f"w{n}", solver, fresh=True, module=module, **place, **shared)
            for n in range(workers if postgres else 0)
        ]
        command = "api" if postgres else "serve"
        api = ServiceProcess(folder / "api", solver, command, module, fresh=True, **place, **shared)
        for worker in own:
            stack.callback(_end, worker)
            worker.launch()
        stack.callback(api.stop)
        api.start()
        for worker in own:
            worker.wait()
        yield ScaleFleet(told, api, own, server, keys)


def _end(worker: WorkerProcess) -> None:
    with suppress(TimeoutError):
        worker.end(SIGTERM)
        return
    worker.end(SIGKILL)
