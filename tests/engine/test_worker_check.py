"""What is said of a worker to whoever asks the database."""

from __future__ import annotations

import asyncio
from pathlib import Path

from support.postgres import needs_postgres, running_postgres

from workers.engine.executor_lock import AdvisoryLock, worker_lives
from workers.engine.takeover import Takeover
from workers.settings import WorkerSettings
from workers.stores.database import open_database
from workers.stores.job_queue import JobQueue


@needs_postgres
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
