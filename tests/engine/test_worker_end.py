"""A worker that ends gives its name back."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest
from support.service import FAKE_SOLVER

from workers.engine.executor_lock import FileLock
from workers.engine.supervisor import Supervisor
from workers.engine.worker import Worker
from workers.settings import WorkerSettings
from workers.solver.pool import SolverPool
from workers.stores.database import open_database
from workers.stores.job_queue import JobQueue
from workers.stores.plan_store import PlanStore


def test_the_name_is_free_for_the_next_worker_even_if_solvers_could_not_be_ended(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    settings = WorkerSettings(data_dir=tmp_path, solver_command=FAKE_SOLVER, worker_slots=1)
    close = SolverPool.close

    async def close_badly(pool: SolverPool) -> None:
        await close(pool)
        raise PermissionError("not allowed to end a process")

    async def run() -> None:
        database, supervisor = open_database(settings), Supervisor()
        queue = JobQueue(database)
        worker = Worker(settings, database, queue, PlanStore(database), supervisor)
        await worker.start()
        await supervisor.stop()
        with pytest.raises(PermissionError):
            await worker.stop()
        queue.close()
        database.close()

    monkeypatch.setattr(SolverPool, "close", close_badly)
    asyncio.run(run())
    FileLock(tmp_path, settings.executor_name).release()
