"""A database that is there and says nothing: whoever asks whether all is well gets an answer in time."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from pathlib import Path

import httpx
import psutil
import psycopg
import pytest

from app.settings import ServiceSettings
from tests.support.postgres import PostgresServer, needs_postgres, running_postgres
from tests.support.service import FAKE_EXAMINER, FAKE_SOLVER, ROOT, task, wait_for
from tests.support.serving import served

CONNECTIONS = 4


@contextmanager
def frozen(server: PostgresServer) -> Iterator[None]:
    """Stop the server and all that serve connections for the time of a block, as a paused virtual machine."""
    assert server.process is not None
    postmaster = psutil.Process(server.process.pid)
    family = [postmaster, *postmaster.children(recursive=True)]
    for process in family:
        # One that only looks after tables may end meanwhile.
        with suppress(psutil.NoSuchProcess):
            process.suspend()
    try:
        yield
    finally:
        for process in family:
            with suppress(psutil.NoSuchProcess):
                process.resume()


@needs_postgres
@pytest.mark.slow
def test_while_its_database_is_frozen_a_service_is_not_ready_at_once_and_uses_few_connections(tmp_path: Path) -> None:
    with running_postgres() as server:
        settings = ServiceSettings.model_validate(
            {
                "data_dir": tmp_path,
                "database_url": server.url,
                "database_connections": CONNECTIONS,
                "solver_command": FAKE_SOLVER,
                "study_command": FAKE_EXAMINER,
                "worker_slots": 1,
                "worker_name": "only",
            }
        )
        with served(settings) as address, httpx.Client(base_url=address, timeout=60.0) as client:
            assert client.get("/readyz").status_code == 200
            with ThreadPoolExecutor(40) as pool:
                sent = [pool.submit(client.post, "/v1/plans", json=task(external_id="now")) for _ in range(40)]
                assert {each.result().status_code for each in sent} == {202}
            with psycopg.connect(server.url) as connection:
                query = "SELECT count(*) FROM pg_stat_activity WHERE datname = 'liftwright' AND pid <> pg_backend_pid()"
                (count,) = connection.execute(query).fetchone() or (None,)
            assert count is not None
            assert count <= CONNECTIONS + 2, "a worker's name and the engine's listener have one each"

            with ThreadPoolExecutor(50) as pool:
                with frozen(server):
                    # All threads that answer requests wait for the database.
                    waiting = [pool.submit(client.get, "/v1/plans") for _ in range(45)]
                    time.sleep(0.5)
                    begun = time.monotonic()
                    answer = httpx.get(f"{address}/readyz", timeout=30.0)
                    assert answer.status_code == 503
                    assert "has not answered" in answer.json()["detail"]
                    assert httpx.get(f"{address}/livez", timeout=5.0).status_code == 200
                    assert time.monotonic() - begun < 8.0
                    begun = time.monotonic()
                    environment = {**os.environ, "LIFTWRIGHT_DATABASE_URL": server.url}
                    command = [sys.executable, "-m", "app.cli.main", "check-worker", "--worker-name", "only"]
                    check = subprocess.run(
                        command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False, timeout=60
                    )
                    assert check.returncode == 1
                    assert "cannot be asked whether the worker lives" in check.stderr
                    assert time.monotonic() - begun < 12.0
                assert {each.result().status_code for each in waiting} <= {200, 503}
            wait_for(lambda: client.get("/readyz").status_code == 200, 30.0)
