"""A worker that ends gives its name back."""

from __future__ import annotations

import asyncio
from pathlib import Path
from threading import Thread

import pytest

from tests.support.accepted import accept
from tests.support.service import FAKE_SOLVER, task, wait_for
from workers.engine.executor_lock import FileLock
from workers.engine.supervisor import Supervisor
from workers.engine.worker import Worker
from workers.settings import WorkerSettings
from workers.solver.pool import SolverPool, SolverProcess
from workers.stores.database import open_database
from workers.stores.job_queue import JobQueue
from workers.stores.plan_store import PlanStore


@pytest.mark.slow
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


@pytest.mark.slow
def test_the_event_loop_ends_though_a_solver_at_work_does_not(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its job stays begun, and waits for the end of the loop, which cancels it once and no more."""
    settings = WorkerSettings(data_dir=tmp_path, solver_command=FAKE_SOLVER, worker_slots=1)
    kill, left = SolverProcess.kill, []

    async def gone_at_last(child: SolverProcess) -> None:
        left.append(child.pid)
        try:
            await asyncio.Event().wait()
        finally:
            await kill(child)

    async def run() -> None:
        database, supervisor = open_database(settings), Supervisor()
        queue, store = JobQueue(database), PlanStore(database)
        worker = Worker(settings, database, queue, store, supervisor)
        await worker.start()
        plan_id = accept(store, task(external_id="hang"), None, queue).id
        await asyncio.to_thread(wait_for, lambda: (store.get(plan_id).stage or "") == "graph")
        monkeypatch.setattr(SolverProcess, "kill", gone_at_last)
        await supervisor.stop()
        await worker.stop()
        queue.close()
        database.close()

    thread = Thread(target=lambda: asyncio.run(run()), daemon=True)
    thread.start()
    thread.join(timeout=60.0)
    assert left
    assert not thread.is_alive()
