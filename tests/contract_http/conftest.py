"""A running app for the tests of the HTTP contract, with a solver that makes its answers up."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest
import uvicorn
from support.service import FAKE_SOLVER

from app.create_app import create_app
from app.settings import ServiceSettings

MAX_QUEUED = 12


@pytest.fixture(scope="module")
def address(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """Serve in a thread, so that a test sees what really goes over the wire.

    Not for longer than needed: the job engine draws random numbers, which tests of properties must not see.
    """
    data_dir: Path = tmp_path_factory.mktemp("data")
    settings = ServiceSettings(data_dir=data_dir, solver_command=FAKE_SOLVER, worker_slots=1, max_queued=MAX_QUEUED)
    app = create_app(settings, with_worker=True)
    server = uvicorn.Server(uvicorn.Config(app, port=0, http="h11", log_level="warning", timeout_graceful_shutdown=1))
    thread = threading.Thread(target=server.run)
    thread.start()
    while not server.started:
        assert thread.is_alive()
        time.sleep(0.02)
    yield f"http://127.0.0.1:{server.servers[0].sockets[0].getsockname()[1]}"
    server.should_exit = True
    thread.join(timeout=30)
    assert not thread.is_alive()


@pytest.fixture
def client(address: str) -> Iterator[httpx.Client]:
    """Talk to it; what a test leaves unfinished is cancelled."""
    with httpx.Client(base_url=address, timeout=30.0) as client:
        yield client
        for plan in client.get("/v1/plans", params={"page_size": 200}).json()["plans"]:
            if not plan["done"]:
                client.post(plan["links"]["cancel"])
