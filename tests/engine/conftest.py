"""A database of one's own for each test, with the queue and the plans in it."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.support.places import database_at
from workers.settings import WorkerSettings
from workers.stores.database import Database, open_database
from workers.stores.job_queue import JobQueue
from workers.stores.plan_store import PlanStore


@pytest.fixture(scope="module")
def place(request: pytest.FixtureRequest) -> Iterator[dict[str, str]]:
    """Settings of the database: SQLite, or what `on_both_databases` says."""
    with database_at(getattr(request, "param", "sqlite")) as settings:
        yield settings


@pytest.fixture
def database(place: dict[str, str], tmp_path: Path) -> Iterator[Database]:
    database = open_database(WorkerSettings.model_validate({"data_dir": tmp_path, **place}))
    yield database
    database.close()


@pytest.fixture
def queue(database: Database) -> Iterator[JobQueue]:
    queue = JobQueue(database)
    yield queue
    queue.close()


@pytest.fixture
def store(database: Database) -> PlanStore:
    return PlanStore(database)
