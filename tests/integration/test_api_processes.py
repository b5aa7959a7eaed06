"""Several processes answer behind one port as one service."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from pathlib import Path

import httpx
import psutil
import pytest

from app.access.caller import Scope
from app.cli.keys_command import issue_key
from app.serve import COUNTS_PREFIX, folder_of_counts
from tests.support.service import FAKE_SOLVER, ServiceProcess, task, wait_for
from workers.settings import WorkerSettings


@pytest.fixture
def service(tmp_path: Path) -> Iterator[ServiceProcess]:
    service = ServiceProcess(tmp_path, FAKE_SOLVER, "api", fresh=True, api_processes=2).start()
    wait_for(lambda: further(service))
    yield service
    service.stop()


def further(service: ServiceProcess) -> list[psutil.Process]:
    """Return the further processes that listen."""
    return [each for each in service.descendants() if is_up(each)]


def is_up(process: psutil.Process) -> bool:
    try:
        # The event loop of a server that has begun waits by epoll.
        waits = [link for link in Path(f"/proc/{process.pid}/fd").iterdir() if "eventpoll" in str(link.readlink())]
        return "app.serve" in process.cmdline() and bool(waits)
    except (psutil.NoSuchProcess, FileNotFoundError):
        return False


def get(service: ServiceProcess, path: str) -> httpx.Response:
    """Ask on a connection of its own: any process may take it."""
    return httpx.get(f"{service.address}{path}", timeout=60.0).raise_for_status()


@pytest.mark.slow
def test_several_processes_are_one_service_and_end_with_the_first(service: ServiceProcess, tmp_path: Path) -> None:
    with service.client() as client:
        plans = [client.post("/v1/plans", json=task()).raise_for_status().json() for _ in range(5)]
    for plan in plans * 4:
        assert get(service, plan["links"]["self"]).json()["id"] == plan["id"]
    # Whoever is asked tells of the requests of all.
    asked = [counted(get(service, "/metrics").text) for _ in range(6)]
    assert asked == [20.0] * 6

    # Whether keys are asked for was decided when the first one started.
    issue_key(WorkerSettings(data_dir=tmp_path), "mes", Scope.READ, None)
    (other,) = further(service)
    other.kill()
    wait_for(lambda: further(service) and further(service) != [other])
    for _ in range(20):
        assert get(service, "/v1/plans").json()["plans"]

    left = further(service)
    service.kill()
    wait_for(lambda: not any(each.is_running() and each.status() != psutil.STATUS_ZOMBIE for each in left), 30.0)


def counted(metrics: str) -> float:
    """Return how many plans were looked at, as a monitoring system reads it."""
    found = re.search(
        r'^liftwright_request_seconds_count{method="GET",route="/v1/plans/{plan_id}",status="200"} (\S+)$',
        metrics,
        re.M,
    )
    assert found is not None
    return float(found[1])


def test_counts_that_a_killed_service_has_left_are_removed_and_those_of_a_living_one_are_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    left = [tmp_path / f"{COUNTS_PREFIX}{name}" for name in ("killed", "just_made")]
    other = tmp_path / "of_another_program"
    for folder in (*left, other):
        folder.mkdir()
        (folder / "counts.db").touch()
    with folder_of_counts() as living:
        for folder in (left[0], other, Path(living)):
            os.utime(folder, (0, 0))
        with folder_of_counts() as second:
            assert set(tmp_path.iterdir()) == {left[1], other, Path(living), Path(second)}
    assert set(tmp_path.iterdir()) == {left[1], other}
