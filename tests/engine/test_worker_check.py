"""What is said of a worker to whoever asks the database."""

from __future__ import annotations

import asyncio
import signal
import time
from pathlib import Path
from typing import Any, cast

import psutil
import pytest

from app.cli.main import main
from tests.support.postgres import needs_postgres, running_postgres
from tests.support.service import FAKE_SOLVER, wait_for
from tests.support.worker import WorkerProcess
from workers.engine.executor_lock import AdvisoryLock, FileLock, worker_lives
from workers.engine.sign_of_life import SignOfLife, shows_life
from workers.engine.supervisor import Supervisor
from workers.engine.takeover import Takeover
from workers.engine.worker import Worker
from workers.settings import EMBEDDED_NAME, WorkerSettings
from workers.stores.database import open_database, server_database
from workers.stores.job_queue import JobQueue


@needs_postgres
@pytest.mark.slow
def test_a_worker_is_well_while_it_has_its_name_and_nothing_in_it_is_stuck(tmp_path: Path) -> None:
    with running_postgres() as server:
        settings = WorkerSettings(data_dir=tmp_path, database_url=server.url, worker_name="only")
        database = open_database(settings)
        queue, stuck = JobQueue(database), list[str]()
        fleet = Takeover(settings, queue, AdvisoryLock(database, "only"), frozenset, lambda: stuck)

        async def look(times: int) -> bool:
            for _ in range(times):
                await fleet.look()
            return worker_lives(settings)

        async def run() -> None:
            assert not worker_lives(settings)
            await fleet.start()
            assert await look(2)
            stuck.append("expiry")
            assert not await look(3)
            stuck.clear()
            assert await look(1)
            stuck.append("expiry")
            assert not await look(1)
            # A worker of the same name that is begun anew says nothing of its last life.
            fleet.stop()
            assert not worker_lives(settings)
            stuck.clear()
            assert await look(1)
            fleet.stop()

        asyncio.run(run())
        queue.close()
        database.close()


@needs_postgres
@pytest.mark.slow
def test_a_worker_that_waits_for_its_database_lives_and_one_that_does_not_get_on_does_not(tmp_path: Path) -> None:
    """Whoever ends what does not live must not end all workers because the database is away."""
    soon = {"watch_seconds": 0.2, "patience_seconds": 0.2, "frozen_seconds": 1.5}
    with running_postgres() as server:
        worker = WorkerProcess("only", tmp_path, FAKE_SOLVER, worker_slots=1, database_url=server.url, **soon)

        def lives(*asked: str) -> bool:
            words = ["--worker-name=only", f"--data-dir={tmp_path}", f"--database-url={server.url}", *asked]
            with pytest.MonkeyPatch.context() as environment:
                for name, seconds in soon.items():
                    environment.setenv(f"LIFTWRIGHT_{name.upper()}", str(seconds))
                return main(["check-worker", *words]) == 0

        assert not lives("--alive")
        worker.start()
        assert worker.process is not None
        wait_for(lambda: lives() and lives("--alive"), 10.0)
        server.kill()
        gone_at = time.monotonic()
        while time.monotonic() < gone_at + 2.5 * soon["frozen_seconds"]:
            assert lives("--alive")
            time.sleep(0.1)
        assert not lives()
        process = psutil.Process(worker.process.pid)
        process.suspend()
        try:
            wait_for(lambda: not lives("--alive"), 10.0)
        finally:
            process.resume()
        wait_for(lambda: lives("--alive"), 10.0)
        server.start()
        wait_for(lives, 30.0)
        worker.end(signal.SIGTERM)
        assert not lives("--alive")


def test_on_sqlite_a_worker_lives_while_its_process_has_the_data_directory(tmp_path: Path) -> None:
    check = ["check-worker", "--alive", f"--data-dir={tmp_path}"]
    lock = FileLock(tmp_path, EMBEDDED_NAME)
    assert main(check) == 0
    lock.release()
    assert main(check) == 1


def test_a_worker_in_which_something_is_stuck_gives_no_sign_of_life(tmp_path: Path) -> None:
    settings = WorkerSettings(data_dir=tmp_path, database_url="postgresql://u@127.0.0.1:1/d", worker_name="only")
    stuck = Supervisor()
    worker = Worker(settings, cast(Any, server_database(settings)), cast(Any, None), cast(Any, None), stuck)

    async def shown() -> bool:
        SignOfLife(settings).withdraw()
        await worker._show_life()
        return shows_life(settings)

    async def run() -> None:
        assert await shown()
        with pytest.MonkeyPatch.context() as patches:
            patches.setattr(Supervisor, "stuck", ["expiry"])
            assert not await shown()
        assert await shown()

    asyncio.run(run())
