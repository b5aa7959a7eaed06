"""Whether the service says that it cannot work, and says so no longer than it is true."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import httpx
import pytest
import uvicorn
from fastapi import FastAPI

from app import create_app as create_app_module
from app.create_app import create_app
from app.resources.plan_feed import PlanFeed
from app.serve import LoadedWhileServing, Start
from app.server.answer_headers import BROWSER_HEADERS, REQUEST_ID
from app.server.configuration import server_configuration
from app.settings import ServiceSettings
from planners.errors import AssetError, LiftwrightError
from tests.support.service import FAKE_EXAMINER, FAKE_SOLVER, task, wait_for
from tests.support.serving import served
from workers.engine import supervisor, worker
from workers.engine.takeover import Takeover
from workers.engine.worker import Worker
from workers.webhooks.runner import WebhookRunner


@pytest.mark.slow
def test_the_service_is_not_ready_while_anything_in_the_background_keeps_failing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    broken, loops = True, ((PlanFeed, "look"), (Takeover, "look"), (WebhookRunner, "look"))
    housekeeping = ((worker, name) for name in ("cancel_overdue", "count_failures", "delete_old", "delete_old_audit"))

    def breakable(work: Callable[..., Any]) -> Callable[..., Any]:
        def wrapped(*arguments: Any) -> Any:
            if broken:
                raise ValueError("out of order")
            return work(*arguments)

        return wrapped

    for owner, name in (*loops, *housekeeping, (Worker, "_leave_lost_jobs")):
        monkeypatch.setattr(owner, name, breakable(getattr(owner, name)))
    monkeypatch.setattr(supervisor, "STUCK_SECONDS", 0.0)
    settings = ServiceSettings(
        data_dir=tmp_path,
        solver_command=FAKE_SOLVER,
        study_command=FAKE_EXAMINER,
        worker_slots=1,
        watch_seconds=0.1,
        retention_days=1.0,
        audit_days=1.0,
    )
    with served(settings) as address, httpx.Client(base_url=address, timeout=60.0) as client:
        names = {"feed", "study feed", "jobs", "fleet", "webhooks", "expiry", "failures", "retention", "audit log"}

        def told() -> str:
            answer = client.get("/readyz")
            return answer.json()["detail"] if answer.status_code == 503 else ""

        wait_for(lambda: all(name in told() for name in names))
        broken = False
        # Nobody follows a plan or a study: what looks for news has nothing to do well yet.
        axes = [{"pointer": "/cup/max_force", "values": [15, 20]}]
        study = client.post("/v1/studies", json={"task": task(), "axes": axes}, headers={"Prefer": "wait=60"})
        assert study.is_success
        plan = client.post("/v1/plans", json=task(external_id="now"), headers={"Prefer": "wait=60"}).json()
        assert plan["state"] == "succeeded"
        wait_for(lambda: told() == "")


@contextmanager
def loading(load: Callable[[Start], Any]) -> Iterator[tuple[httpx.Client, LoadedWhileServing]]:
    """Serve what is still loaded, in a thread of the test."""
    service = LoadedWhileServing(load)
    server = uvicorn.Server(server_configuration(service, ServiceSettings(port=0), goodbye_seconds=1))
    service.on_failure = lambda: setattr(server, "should_exit", True)
    thread = threading.Thread(target=server.run)
    thread.start()
    wait_for(lambda: server.started)
    address = f"http://127.0.0.1:{server.servers[0].sockets[0].getsockname()[1]}"
    try:
        with httpx.Client(base_url=address) as client:
            yield client, service
    finally:
        server.should_exit = True
        thread.join(timeout=30)
        assert not thread.is_alive()


def test_what_takes_long_is_begun_on_the_services_loop_while_it_loads(tmp_path: Path) -> None:
    """So solvers load beside the service, not after it."""
    begun, seen = threading.Event(), list[bool]()

    def load(start: Start) -> FastAPI:
        start.call(begun.set)
        seen.append(begun.wait(60))
        return create_app(ServiceSettings(data_dir=tmp_path), with_worker=False)

    with loading(load) as (client, _):
        wait_for(lambda: client.get("/readyz").is_success)
    assert seen == [True]


def test_while_it_loads_a_service_lives_is_not_ready_and_says_what_is_waited_for(tmp_path: Path) -> None:
    loaded = threading.Event()

    def load(start: Start) -> FastAPI:
        start.tell("compiling for a minute")
        loaded.wait(60)
        return create_app(ServiceSettings(data_dir=tmp_path), with_worker=False)

    with loading(load) as (client, _):
        wait_for(lambda: "compiling for a minute" in client.get("/readyz").json()["detail"])
        assert client.get("/livez").json() == {"status": "alive"}
        for method, path in (("GET", "/readyz"), ("GET", "/v1/plans"), ("POST", "/v1/plans"), ("GET", "/viewer/")):
            answer = client.request(method, path)
            assert (answer.status_code, answer.headers["content-type"]) == (503, "application/problem+json")
            assert all(name in answer.headers for name in (REQUEST_ID, *BROWSER_HEADERS))
            assert "Retry-After" in answer.headers
        page = client.get("/viewer/", headers={"Accept": "text/html,*/*;q=0.8"})
        assert (page.status_code, page.headers["content-type"]) == (503, "text/html; charset=utf-8")
        assert "compiling for a minute" in page.text
        assert 'http-equiv="refresh"' in page.text
        loaded.set()
        wait_for(lambda: client.get("/readyz").status_code == 200)
        assert client.get("/v1/plans").json()["plans"] == []


def test_a_service_that_can_never_be_loaded_ends_with_the_reason() -> None:
    tried = threading.Event()

    def load(_: Start) -> Any:
        tried.wait(60)
        raise LiftwrightError("the solver does not work")

    with loading(load) as (_, service):
        tried.set()
        wait_for(lambda: service.failure is not None)
        assert str(service.failure) == "the solver does not work"


def test_a_service_that_still_loads_stops_when_it_is_told_to() -> None:
    loaded = threading.Event()

    def load(_: Start) -> Any:
        loaded.wait(60)
        raise LiftwrightError("nobody waits for that any more")

    with loading(load) as (client, service):
        assert client.get("/readyz").status_code == 503
    loaded.set()
    assert service.failure is None


@pytest.mark.slow
def test_a_service_whose_shipped_cells_cannot_be_loaded_is_not_ready(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def missing() -> None:
        raise AssetError("a mesh of ur3e is missing")

    monkeypatch.setattr(create_app_module, "load_cells", missing)
    settings = ServiceSettings(
        data_dir=tmp_path, solver_command=FAKE_SOLVER, study_command=FAKE_EXAMINER, worker_slots=1
    )
    with served(settings) as address:
        wait_for(lambda: httpx.get(f"{address}/readyz").status_code == 503, 30.0)
        assert "a shipped cell cannot be loaded" in httpx.get(f"{address}/readyz").json()["detail"]
