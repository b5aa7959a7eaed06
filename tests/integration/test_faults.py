"""Real processes that are killed: whatever dies, every accepted job ends, and nothing is left running."""

from __future__ import annotations

import signal
import time
from collections.abc import Iterator
from pathlib import Path

import httpx
import psutil
import pytest

from tests.support.service import FAKE_SOLVER, ServiceProcess, finished, running_service, task, wait_for
from workers.stores.job_queue import INTERRUPTED_TOO_OFTEN

LONGEST_CANCEL_SECONDS = 1.0
LONGEST_ORPHAN_SECONDS = 2.0


@pytest.fixture(scope="module")
def data_dir(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("data")


@pytest.fixture(scope="module")
def shared(data_dir: Path) -> Iterator[ServiceProcess]:
    with running_service(data_dir, FAKE_SOLVER, worker_slots=1) as service:
        yield service


@pytest.fixture
def service(shared: ServiceProcess) -> ServiceProcess:
    """Return a service that runs; started again where the test before this one left none."""
    return shared if shared.process is not None else shared.start()


def post(client: httpx.Client, wish: str) -> dict:
    answer = client.post("/v1/plans", json=task(external_id=wish))
    assert answer.status_code == 202
    return answer.json()


def running(client: httpx.Client, plan: dict) -> bool:
    now = client.get(plan["links"]["self"]).json()
    return now["state"] == "running" and now["progress"]["fraction"] > 0.0


def solvers(service: ServiceProcess) -> list[psutil.Process]:
    """The service's children, oldest first: a solver before the fork that is at work."""
    return sorted(service.descendants(), key=lambda process: process.create_time())


def gone(processes: list[psutil.Process]) -> bool:
    return not any(process.is_running() and process.status() != psutil.STATUS_ZOMBIE for process in processes)


@pytest.mark.slow
def test_a_job_whose_solver_is_killed_is_begun_again_and_ends(service: ServiceProcess) -> None:
    with service.client() as client:
        plan = post(client, "steps-40")
        wait_for(lambda: running(client, plan))
        solvers(service)[0].kill()
        plan = finished(client, plan)
        assert (plan["state"], plan["outcome"], plan["attempts"]) == ("succeeded", "solved", 2)


@pytest.mark.slow
def test_jobs_survive_a_service_that_is_killed_and_leave_no_process_behind(service: ServiceProcess) -> None:
    with service.client() as client:
        under_way, waiting = post(client, "steps-60"), post(client, "now")
        wait_for(lambda: running(client, under_way))
        shown = client.get(under_way["links"]["self"]).json()["progress"]["fraction"]
    orphans = service.descendants()
    assert orphans
    service.kill()
    wait_for(lambda: gone(orphans), LONGEST_ORPHAN_SECONDS)
    service.start()
    with service.client() as client:
        again = client.get(under_way["links"]["self"]).json()
        assert again["progress"]["fraction"] >= shown
        for plan in under_way, waiting:
            plan = finished(client, plan)
            assert (plan["state"], plan["outcome"]) == ("succeeded", "solved")
            assert client.get(plan["links"]["document"]).json()["id"] == plan["id"]
        assert client.get(under_way["links"]["self"]).json()["attempts"] == 2


@pytest.mark.slow
def test_a_certified_plan_outlives_a_service_that_is_killed_and_is_the_one_that_is_simulated_then(
    service: ServiceProcess,
) -> None:
    with service.client() as client:
        plan = post(client, "simulate-60")
        wait_for(lambda: client.get(plan["links"]["self"]).json()["certified_at"])
        before = client.get(plan["links"]["document"])
    service.kill()
    service.start()
    with service.client() as client:
        again = client.get(plan["links"]["document"], headers={"If-None-Match": before.headers["ETag"]})
        assert again.status_code == 304
        assert finished(client, plan)["state"] == "succeeded"
        after = client.get(plan["links"]["document"]).json()
        assert after == {**before.json(), "simulation": {"outcome": "lifted"}}


@pytest.mark.slow
def test_a_service_that_is_asked_to_stop_gives_its_job_to_the_next_one(service: ServiceProcess) -> None:
    with service.client() as client:
        plan = post(client, "steps-60")
        wait_for(lambda: running(client, plan))
    children = service.descendants()
    service.stop()
    assert gone(children)
    service.start()
    with service.client() as client:
        assert finished(client, plan)["outcome"] == "solved"


@pytest.mark.slow
def test_cancelling_ends_the_whole_process_group_within_a_second(service: ServiceProcess) -> None:
    with service.client() as client:
        plan = post(client, "child")
        wait_for(lambda: running(client, plan))
        at_work = solvers(service)[0]
        # The fork at work, and what that starts.
        wait_for(lambda: len(at_work.children(recursive=True)) == 2)
        group = [at_work, *at_work.children(recursive=True)]
        begun = time.perf_counter()
        assert client.post(plan["links"]["cancel"]).status_code == 202
        wait_for(lambda: gone(group), LONGEST_CANCEL_SECONDS)
        assert time.perf_counter() - begun < LONGEST_CANCEL_SECONDS
        assert finished(client, post(client, "now"))["outcome"] == "solved"


@pytest.mark.slow
def test_a_job_that_takes_the_service_with_it_each_time_is_given_up_and_the_next_one_runs(tmp_path: Path) -> None:
    with running_service(tmp_path, FAKE_SOLVER, worker_slots=1, interruption_limit=2) as service:
        with service.client() as client:
            poison = post(client, "hang")
            for _ in range(3):
                wait_for(lambda: running(client, poison))
                service.kill()
                service.start()
            poison = finished(client, poison)
            assert poison["state"] == "failed"
            assert poison["error"]["detail"] == INTERRUPTED_TOO_OFTEN
            assert client.get(poison["links"]["document"]).status_code == 404
            given_up = 'liftwright_failed_jobs_total{why="interruptions"} 1.0'
            wait_for(lambda: given_up in client.get("/metrics").text.splitlines())
            assert finished(client, post(client, "now"))["outcome"] == "solved"


@pytest.mark.slow
def test_an_idle_solver_that_is_killed_costs_no_job(service: ServiceProcess) -> None:
    with service.client() as client:
        killed = solvers(service)
        for process in killed:
            process.send_signal(signal.SIGKILL)
        # Before the worker has been told of their end, one of them may still be given the job.
        psutil.wait_procs(killed, timeout=20)
        plan = finished(client, post(client, "now"))
        assert (plan["state"], plan["attempts"]) == ("succeeded", 1)


def test_a_data_directory_has_one_worker(service: ServiceProcess, data_dir: Path) -> None:
    assert service.process is not None
    rival = ServiceProcess(data_dir, FAKE_SOLVER)
    with pytest.raises(AssertionError, match="ended instead"):
        rival.start()
    assert rival.process is not None
    assert rival.process.wait() != 0
