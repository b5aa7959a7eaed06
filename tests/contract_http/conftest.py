"""A running app for the tests of the HTTP contract, with a solver that makes its answers up."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest

from app.settings import ServiceSettings
from tests.support.places import database_at
from tests.support.service import FAKE_SOLVER
from tests.support.serving import served

MAX_QUEUED = 12


@pytest.fixture(scope="module")
def place(request: pytest.FixtureRequest) -> Iterator[dict[str, str]]:
    """Settings of the database: SQLite, or what `on_one_or_both_databases` says."""
    with database_at(getattr(request, "param", "sqlite")) as settings:
        yield settings


@pytest.fixture(scope="module")
def address(tmp_path_factory: pytest.TempPathFactory, place: dict[str, str]) -> Iterator[str]:
    """Serve without keys."""
    data_dir: Path = tmp_path_factory.mktemp("data")
    limits = {"worker_slots": 1, "max_queued": MAX_QUEUED}
    settings = ServiceSettings.model_validate({"data_dir": data_dir, "solver_command": FAKE_SOLVER, **limits, **place})
    with served(settings) as address:
        yield address


@pytest.fixture(scope="module")
def connection(address: str) -> Iterator[httpx.Client]:
    """Talk to it."""
    with httpx.Client(base_url=address, timeout=120.0) as client:
        yield client


@pytest.fixture
def client(connection: httpx.Client) -> Iterator[httpx.Client]:
    """Talk to it; what a test leaves unfinished is cancelled."""
    yield connection
    for state in ("queued", "running"):
        for plan in connection.get("/v1/plans", params={"page_size": 200, "state": state}).json()["plans"]:
            connection.post(plan["links"]["cancel"])
