"""A job that takes too long, too much, or its solver with it, ends as failed with a sentence that says so."""

from __future__ import annotations

import os
import resource
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import psutil
import pytest

from tests.support.service import FAKE_SOLVER, ServiceProcess, finished, running_service, task, wait_for

SOLVER_SECONDS = 3.0


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ServiceProcess]:
    """No limit of time: behind other work a solver takes seconds to fill its memory."""
    limits = {"solver_memory_mb": 400, "crash_limit": 2}
    with running_service(tmp_path_factory.mktemp("data"), FAKE_SOLVER, worker_slots=1, **limits) as service:
        yield service


@pytest.fixture
def client(service: ServiceProcess) -> Iterator[httpx.Client]:
    with service.client() as client:
        yield client


def end_of(client: httpx.Client, wish: str) -> dict[str, Any]:
    answer = client.post("/v1/plans", json=task(external_id=wish))
    assert answer.status_code == 202
    return finished(client, answer.json())


def require_failure(service: ServiceProcess, client: httpx.Client, wish: str, sentence: str) -> None:
    """A job fails with a sentence, leaves no process, and does not stop the next."""
    plan = end_of(client, wish)
    assert plan["state"] == "failed"
    assert plan["error"]["detail"].startswith(sentence)
    wait_for(lambda: len(service.descendants()) <= 1, 5.0)
    assert end_of(client, "now")["outcome"] == "solved"


@pytest.mark.parametrize(
    ("wish", "sentence"),
    [
        ("eat", "the task needs more memory than a solver may take (400 MiB"),
        ("die", "given up after 2 attempts: the solver process ended without an answer (signal SIGKILL)"),
    ],
)
def test_a_job_beyond_its_memory_or_that_ends_its_solver_fails(
    service: ServiceProcess, client: httpx.Client, wish: str, sentence: str
) -> None:
    require_failure(service, client, wish, sentence)


@pytest.mark.slow
def test_a_job_that_takes_too_long_fails_with_the_processes_it_has_started(tmp_path: Path) -> None:
    with (
        running_service(tmp_path, FAKE_SOLVER, worker_slots=1, solver_seconds=SOLVER_SECONDS) as service,
        service.client() as client,
    ):
        require_failure(service, client, "child", "the solver was stopped after 3 s, the longest it may take")


@pytest.mark.slow
def test_a_full_disk_is_a_503_and_afterwards_everything_goes_on(service: ServiceProcess, client: httpx.Client) -> None:
    """No file may grow: what the database layer sees is what it sees on a full disk."""
    assert service.process is not None
    under_way = client.post("/v1/plans", json=task(external_id="steps-20")).json()
    resource.prlimit(service.process.pid, resource.RLIMIT_FSIZE, (0, resource.RLIM_INFINITY))
    try:
        answer = client.post("/v1/plans", json=task(external_id="now"))
        assert (answer.status_code, answer.headers["Content-Type"]) == (503, "application/problem+json")
        assert client.get(under_way["links"]["self"]).status_code == 200
        assert client.get("/readyz").status_code == 503
        time.sleep(2.0)
    finally:
        whole = (resource.RLIM_INFINITY, resource.RLIM_INFINITY)
        resource.prlimit(service.process.pid, resource.RLIMIT_FSIZE, whole)
    assert finished(client, under_way)["outcome"] == "solved"
    assert end_of(client, "now")["outcome"] == "solved"


def test_solvers_stand_back_behind_the_service_and_all_other_sessions(service: ServiceProcess) -> None:
    """Between sessions the kernel shares cores by the sessions' niceness, whatever that of their processes."""
    assert service.process is not None
    wait_for(service.descendants)
    api = psutil.Process(service.process.pid)
    for solver in service.descendants():
        wait_for(lambda solver=solver: solver.nice() == api.nice() + 10)
        assert os.getsid(solver.pid) == solver.pid
        wait_for(lambda solver=solver: session_niceness(solver.pid) in (None, solver.nice()))


def session_niceness(process: int) -> int | None:
    """Return that of the session of a process; None where the kernel weighs none."""
    try:
        return int(Path(f"/proc/{process}/autogroup").read_text().split()[-1])
    except FileNotFoundError:
        return None


def test_the_limits_hold_for_the_solver_and_not_for_the_service(service: ServiceProcess) -> None:
    assert service.process is not None
    assert psutil.Process(service.process.pid).rlimit(psutil.RLIMIT_DATA) != (400 * 2**20, 400 * 2**20)
    wait_for(service.descendants)
    for solver in service.descendants():
        assert solver.rlimit(psutil.RLIMIT_DATA) == (400 * 2**20, 400 * 2**20)
