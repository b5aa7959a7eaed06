"""What `make fleet` would not let pass, tried without containers."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, cast

import httpx
import pytest

from tests.deployment import containers, fleet
from tests.deployment.containers import PROGRAMS, missing_packages
from tests.deployment.fleet import Fleet, FleetFigures, faults_of_hardening

STATUS = """Name:\tliftwright
Uid:\t10001\t10001\t10001\t10001
Gid:\t10001\t10001\t10001\t10001
CapInh:\t0000000000000000
CapPrm:\t0000000000000000
CapEff:\t0000000000000000
CapBnd:\t0000000000000000
NoNewPrivs:\t1
"""
MOUNTS = """overlay / overlay ro,relatime,lowerdir=/a:/b 0 0
proc /proc proc rw,nosuid 0 0
"""


def test_a_container_is_hardened_if_its_first_process_is() -> None:
    assert faults_of_hardening(STATUS, MOUNTS) == []
    for status, fault in {
        STATUS.replace("Uid:\t10001", "Uid:\t0"): "runs as root",
        STATUS.replace("Gid:\t10001", "Gid:\t0"): "runs as root",
        STATUS.replace("CapBnd:\t0000000000000000", "CapBnd:\t00000000a80425fb"): "has capabilities",
        STATUS.replace("NoNewPrivs:\t1", "NoNewPrivs:\t0"): "may gain privileges",
    }.items():
        assert faults_of_hardening(status, MOUNTS) == [fault]
    for mounts in (MOUNTS.replace(" ro,", " rw,"), MOUNTS.partition("\n")[2]):
        assert faults_of_hardening(STATUS, mounts) == ["can write to its root file system"]


def test_programs_that_are_not_there_are_told_as_packages(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(containers.shutil, "which", lambda program, path: None if program == "runc" else "/there")
    assert missing_packages() == ["runc"]
    monkeypatch.setattr(containers.shutil, "which", lambda program, path: None)
    assert missing_packages() == list(PROGRAMS.values())
    assert {"podman", "buildah", "netavark", "aardvark-dns", "debootstrap"} <= set(PROGRAMS.values())


def test_the_packages_that_are_asked_for_are_those_that_the_readme_names() -> None:
    found = re.search(r"apt-get install --no-install-recommends ([^`]+)`", (fleet.ROOT / "README.md").read_text())
    assert found is not None
    assert sorted(found[1].split()) == sorted(PROGRAMS.values())


class MadeUpFleet:
    """A service whose jobs end when something is killed, and that does with one of them what it must not."""

    def __init__(self, fault: str | None) -> None:
        self.fault, self.kills = fault, 0
        self.plans: dict[str, dict[str, Any]] = {}
        self.made = 0

    def names(self, service: str) -> list[str]:
        return [f"liftwright_{service}_1"]

    def kill(self, name: str) -> int:
        self.kills += 1
        return self.kills

    def begin_again(self, name: str, killed: int) -> None:
        assert killed == self.kills

    def wait_until_ready(self, workers: int) -> None:
        assert workers == fleet.MORE_WORKERS

    @contextmanager
    def client(self) -> Iterator[httpx.Client]:
        transport = httpx.MockTransport(self._answer)
        with httpx.Client(base_url="http://made.up", transport=transport) as client:
            yield client

    def _answer(self, request: httpx.Request) -> httpx.Response:
        path = request.url.path
        if request.method == "POST":
            return self._accepted(request.headers["Idempotency-Key"])
        if path == "/metrics":
            return httpx.Response(200, text=f'liftwright_documents_made_total{{outcome="solved"}} {self.made}.0\n')
        if path == "/v1/plans":
            return httpx.Response(200, json={"plans": list(self.plans.values()), "next_page_token": None})
        plan = self.plans[path.split("/")[3]]
        if path.endswith("/document"):
            content = json.dumps({"id": plan["id"]}).encode()
            name = hashlib.sha256(content).hexdigest()
            spoiled = content + b" " if self.fault == "spoiled" else content
            return httpx.Response(200, content=spoiled, headers={"ETag": f'W/"{name}"'})
        if not plan["done"]:
            self.made += 2 if self.fault == "done twice" else 1
            plan.update(done=True, state="failed" if self.fault == "failed" else "succeeded")
        return httpx.Response(200, json=plan)

    def _accepted(self, key: str) -> httpx.Response:
        # Of the first try the answer is lost.
        lost = key not in self.plans
        if lost or self.fault == "accepted twice":
            number = key if lost else f"{key}-again"
            links = {"self": f"/v1/plans/{number}", "document": f"/v1/plans/{number}/document"}
            self.plans[number] = {"id": number, "done": False, "state": "queued", "attempts": 2, "links": links}
        return httpx.Response(503) if lost else httpx.Response(200, json=self.plans[key])


@pytest.mark.parametrize(
    ("fault", "told"),
    [
        (None, None),
        ("failed", "succeeds, and is not failed"),
        ("done twice", "each job has made one document"),
        ("accepted twice", "no task was accepted twice"),
        ("spoiled", "is what its hash says"),
    ],
)
def test_a_job_that_is_not_done_once_and_whole_ends_the_run(
    monkeypatch: pytest.MonkeyPatch, fault: str | None, told: str | None
) -> None:
    monkeypatch.setattr(fleet.time, "sleep", lambda _: None)
    assert sum(fleet.KILLS.values()) >= 20
    assert set(fleet.KILLS) == set(fleet.SERVICES)
    made_up, figures = MadeUpFleet(fault), FleetFigures()
    with made_up.client() as client:
        if told is not None:
            with pytest.raises(RuntimeError, match=told):
                fleet._kill_at_random(cast(Fleet, made_up), client, figures)
            return
        fleet._kill_at_random(cast(Fleet, made_up), client, figures)
    assert figures.kills == fleet.KILLS
    assert made_up.kills == sum(fleet.KILLS.values())
    assert (figures.outlived, figures.begun_anew) == (made_up.kills, made_up.kills)
