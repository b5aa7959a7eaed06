"""API and workers apart on PostgreSQL: what happens when one of them, or the database, is gone for a while."""

from __future__ import annotations

import signal
import time
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx
import psutil
import pytest

from tests.support.postgres import PostgresServer, needs_postgres, running_postgres
from tests.support.service import FAKE_SOLVER, ServiceProcess, finished, running_service, task, wait_for
from tests.support.worker import WorkerProcess
from workers.stores.job_queue import INTERRUPTED_TOO_OFTEN

pytestmark = needs_postgres
SETTINGS = {"worker_slots": 1, "watch_seconds": 0.5, "patience_seconds": 3.0, "frozen_seconds": 12.0}


@dataclass(frozen=True)
class Fleet:
    server: PostgresServer
    api: ServiceProcess
    client: httpx.Client
    first: WorkerProcess
    second: WorkerProcess

    def with_both_workers(self) -> None:
        """Start what an earlier test has left stopped."""
        stopped = [worker for worker in (self.first, self.second) if worker.process is None]
        for worker in stopped:
            worker.launch()
        for worker in stopped:
            worker.wait()

    def post(self, wish: str) -> dict[str, Any]:
        answer = self.client.post("/v1/plans", json=task(external_id=wish))
        assert answer.status_code == 202, answer.text
        return answer.json()

    def plan(self, plan: dict[str, Any]) -> dict[str, Any]:
        return self.client.get(plan["links"]["self"]).json()

    def begun(self, plan: dict[str, Any], attempt: int = 1) -> bool:
        """Tell whether an attempt has begun: what is running and is nobody's looks as it did in the one before."""
        now = self.plan(plan)
        return now["state"] == "running" and now["progress"]["fraction"] > 0.0 and now["attempts"] >= attempt


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Fleet]:
    folder: Path = tmp_path_factory.mktemp("fleet")
    with ExitStack() as stack:
        server = stack.enter_context(running_postgres())
        settings = {**SETTINGS, "database_url": server.url}
        api = stack.enter_context(running_service(folder / "api", FAKE_SOLVER, command="api", **settings))
        first, second = (WorkerProcess(name, folder / name, FAKE_SOLVER, **settings) for name in ("first", "second"))
        stack.callback(first.end, signal.SIGTERM)
        stack.callback(second.end, signal.SIGTERM)
        yield Fleet(server, api, stack.enter_context(api.client()), first, second)


@pytest.mark.slow
def test_another_worker_takes_over_what_a_dead_one_had_and_its_processes_are_gone(fleet: Fleet) -> None:
    fleet.first.start()
    plan = fleet.post("steps-100")
    wait_for(lambda: fleet.begun(plan))
    solvers = fleet.first.solvers()
    fleet.first.end(signal.SIGKILL)
    fleet.second.start()
    plan = finished(fleet.client, plan)
    assert (plan["state"], plan["outcome"], plan["attempts"]) == ("succeeded", "solved", 2)
    assert not any(process.is_running() and process.status() != psutil.STATUS_ZOMBIE for process in solvers)
    assert "liftwright_jobs_begun_anew_total 1" in fleet.client.get("/metrics").text
    fleet.second.end(signal.SIGTERM)


@pytest.mark.slow
def test_another_worker_simulates_the_plan_that_a_dead_one_has_certified(fleet: Fleet) -> None:
    fleet.first.start()
    plan = fleet.post("simulate-100")
    wait_for(lambda: fleet.plan(plan)["certified_at"])
    before = fleet.client.get(plan["links"]["document"])
    fleet.first.end(signal.SIGKILL)
    fleet.second.start()
    assert fleet.client.get(plan["links"]["document"]).headers["ETag"] == before.headers["ETag"]
    assert finished(fleet.client, plan)["attempts"] == 2
    after = fleet.client.get(plan["links"]["document"]).json()
    assert after == {**before.json(), "simulation": {"outcome": "lifted"}}
    fleet.second.end(signal.SIGTERM)


@pytest.mark.slow
def test_a_worker_that_lives_is_not_robbed(fleet: Fleet) -> None:
    fleet.with_both_workers()
    plans = [fleet.post("steps-60") for _ in range(2)]
    assert [finished(fleet.client, plan)["attempts"] for plan in plans] == [1, 1]


@pytest.mark.slow
def test_two_workers_cannot_share_a_name(fleet: Fleet) -> None:
    fleet.with_both_workers()
    rival = WorkerProcess(
        "first", fleet.first.data_dir.with_name("rival"), FAKE_SOLVER, **SETTINGS, database_url=fleet.server.url
    )
    rival.launch()
    assert rival.process is not None
    assert rival.process.wait(timeout=300) == 1
    assert "already runs" in rival.log


@pytest.mark.slow
@pytest.mark.parametrize("cut", [True, False], ids=["cut off", "connected"])
def test_a_frozen_worker_loses_its_job_to_another_and_does_no_harm_when_it_wakes(fleet: Fleet, cut: bool) -> None:
    """Frozen, its connection is cut by the server, as after a network failure; or it is not, as in a paused machine."""
    fleet.with_both_workers()
    plan = fleet.post("steps-80")
    wait_for(lambda: fleet.begun(plan))
    workers = [fleet.first, fleet.second]
    (owner,) = [worker for worker in workers if worker.name == fleet.server.owner_of(plan["id"])]
    assert owner.process is not None
    family = [psutil.Process(owner.process.pid), *owner.solvers()]
    for process in family:
        process.suspend()
    try:
        if cut:
            fleet.server.cut(owner.name)
        taken = finished(fleet.client, plan)
    finally:
        for process in family:
            process.resume()
    document = fleet.client.get(plan["links"]["document"]).content
    told = f"{fleet.first.log[-3000:]}\n{fleet.second.log[-3000:]}"
    assert (taken["state"], taken["attempts"]) == ("succeeded", 2), told
    time.sleep(3 * SETTINGS["watch_seconds"] + 2.0)
    assert fleet.plan(plan) == taken
    assert fleet.client.get(plan["links"]["document"]).content == document
    # Both work again.
    assert [finished(fleet.client, each)["state"] for each in [fleet.post("steps-20") for _ in range(3)]] == [
        "succeeded"
    ] * 3


@pytest.mark.slow
@pytest.mark.parametrize("seconds", [3.0, 30.0])
def test_without_its_database_the_api_answers_503_and_everything_goes_on_when_it_is_back(
    fleet: Fleet, seconds: float
) -> None:
    fleet.with_both_workers()
    plan, endless, waiting = fleet.post("steps-100"), fleet.post("hang"), fleet.post("now")
    wait_for(lambda: fleet.begun(plan) and fleet.begun(endless))
    (owner,) = [each for each in (fleet.first, fleet.second) if each.name == fleet.server.owner_of(endless["id"])]
    # The youngest is that of the job.
    *_, solver = owner.solvers()
    fleet.server.stop()
    stopped = time.monotonic()
    for method, path in (("GET", plan["links"]["self"]), ("GET", "/v1/plans"), ("GET", "/readyz"), ("GET", "/metrics")):
        answer = fleet.client.request(method, path)
        assert (answer.status_code, answer.headers["Content-Type"]) == (503, "application/problem+json"), path
        assert int(answer.headers["Retry-After"]) > 0
    assert fleet.client.post("/v1/plans", json=task()).status_code == 503
    assert fleet.client.get("/livez").status_code == 200
    if seconds > SETTINGS["watch_seconds"] + SETTINGS["patience_seconds"]:
        # Another worker may have its job by then.
        wait_for(lambda: not solver.is_running(), SETTINGS["watch_seconds"] + SETTINGS["patience_seconds"] + 2.0)
    time.sleep(max(0.0, stopped + seconds - time.monotonic()))
    fleet.server.start()
    for each in (plan, waiting):
        assert finished(fleet.client, each)["outcome"] == "solved"
    assert fleet.client.post(endless["links"]["cancel"]).status_code == 202
    assert fleet.client.get("/readyz").status_code == 200


@pytest.mark.slow
def test_a_database_that_takes_no_writes_is_waited_for_and_what_can_be_read_is_answered(fleet: Fleet) -> None:
    """As after a failover, while connections lead to the server that was the primary."""
    fleet.with_both_workers()
    ended = finished(fleet.client, fleet.post("now"))
    plan, waiting = fleet.post("steps-60"), fleet.post("now")
    wait_for(lambda: fleet.begun(plan))
    fleet.server.take_writes(takes=False)
    try:
        refused = [("POST", "/v1/plans"), ("POST", plan["links"]["cancel"]), ("DELETE", ended["links"]["self"])]
        for method, path in (*refused, ("GET", "/readyz")):
            answer = fleet.client.request(method, path, json=task() if path == "/v1/plans" else None)
            assert (answer.status_code, answer.headers["Content-Type"]) == (503, "application/problem+json"), path
        assert fleet.plan(ended) == ended
        # Longer than the job takes, and than anybody waits before looking around again.
        time.sleep(6.0)
    finally:
        fleet.server.take_writes(takes=True)
    for each in (plan, waiting, fleet.post("now")):
        assert finished(fleet.client, each)["outcome"] == "solved"
    assert fleet.client.get("/readyz").status_code == 200


@pytest.mark.slow
def test_a_cancelled_job_is_stopped_within_a_second_wherever_it_runs(fleet: Fleet) -> None:
    fleet.with_both_workers()
    plan = fleet.post("child")
    wait_for(lambda: fleet.begun(plan))
    at_work = [each for worker in (fleet.first, fleet.second) for each in worker.solvers() if each.children()]
    assert at_work
    begun = time.perf_counter()
    assert fleet.client.post(plan["links"]["cancel"]).status_code == 202
    wait_for(lambda: not any(each.is_running() and each.status() != psutil.STATUS_ZOMBIE for each in at_work), 1.0)
    assert time.perf_counter() - begun < 1.0
    assert fleet.plan(plan)["state"] == "cancelled"


@pytest.mark.slow
def test_a_job_that_takes_each_worker_with_it_is_given_up_and_the_next_one_runs(tmp_path: Path) -> None:
    with running_postgres() as server:
        settings = {**SETTINGS, "interruption_limit": 2, "database_url": server.url}
        worker = WorkerProcess("only", tmp_path / "only", FAKE_SOLVER, **settings)
        with running_service(tmp_path / "api", FAKE_SOLVER, command="api", **settings) as api, api.client() as client:
            fleet = Fleet(server, api, client, worker, worker)
            poison = fleet.post("hang")
            worker.start()
            try:
                for attempt in range(1, 4):
                    wait_for(lambda attempt=attempt: fleet.begun(poison, attempt))
                    worker.end(signal.SIGKILL)
                    worker.start()
                poison = finished(client, poison)
                assert (poison["state"], poison["error"]["detail"]) == ("failed", INTERRUPTED_TOO_OFTEN)
                assert finished(client, fleet.post("now"))["outcome"] == "solved"
            finally:
                worker.end(signal.SIGTERM)
