"""POST /v1/tasks/check says what POST /v1/plans would do, and leaves no trace."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest

from app.access.caller import Scope
from app.cli.keys_command import issue_key
from app.settings import ServiceSettings
from tests.support.service import FAKE_SOLVER, task
from tests.support.serving import served

BODIES: dict[str, Any] = {
    "a lift that can be begun": task(),
    "a lift that leaves the cup's place open": task(cup={"radius": 0.0175, "max_force": 20}),
    "a cup that is larger than the plate": task(cup={"radius": 0.2, "max_force": 20}),
    "a pile that can be begun": task("domino_pile.json"),
    "a plate in the air": task(plate_pose=[0.3, 0, 1.5, 1, 0, 0, 0]),
    "two members that are wrong": task(plate={"mass": "4"}, colour="red"),
    "a valid choice that there is": task(cell="moon_base"),
    "a body that is no object": [],
    "objects that fall together": task(
        "domino_pile.json", objects=[{**each, "mass": 1e9} for each in task("domino_pile.json")["objects"]]
    ),
    "a scene that there is not": task("domino_pile.json", scene_id="none"),
}


@pytest.mark.parametrize("what", BODIES)
def test_a_check_answers_as_a_post_does(client: httpx.Client, what: str) -> None:
    checked = client.post("/v1/tasks/check", json=BODIES[what])
    assert checked.status_code == 200
    told = checked.json()
    posted = client.post("/v1/plans", json=BODIES[what])
    assert told["accepted"] == (posted.status_code == 202)
    refused = posted.json().get("errors", [])
    assert [{"allowed": None, **each} for each in refused] == told["errors"]
    assert (told["task"] is None) == bool(refused)


def test_the_task_that_is_told_is_the_one_that_is_planned(client: httpx.Client) -> None:
    told = client.post("/v1/tasks/check", json=task()).json()["task"]
    assert told["options"]["reserve"] == 0.1, "defaults are filled in"
    again = client.post("/v1/tasks/check", json=told).json()
    assert again == {"accepted": True, "errors": [], "warnings": [], "task": told}


def test_what_was_most_probably_not_meant_is_told_by_check_and_post(client: httpx.Client) -> None:
    turned = task(plate_pose=[0.3, 0, 1.114, 0, 0, 0, 1])
    checked = client.post("/v1/tasks/check", json=turned).json()
    posted = client.post("/v1/plans", json=turned)
    assert (checked["accepted"], posted.status_code) == (True, 202)
    assert checked["warnings"] == posted.json()["warnings"]
    assert [each["pointer"] for each in checked["warnings"]] == ["/plate_pose"]
    assert client.post("/v1/plans", json=task()).json()["warnings"] == []
    assert "warnings" not in client.get(posted.json()["links"]["self"]).json()


def test_what_is_left_open_is_told_as_open(client: httpx.Client) -> None:
    """Where the cup sits is found by planning, and told by the document."""
    open_task = task(cup={"radius": 0.0175, "max_force": 20})
    told = client.post("/v1/tasks/check", json=open_task).json()["task"]
    assert told["cup"]["position"] is None
    assert client.post("/v1/tasks/check", json=told).json()["task"] == told
    assert client.post("/v1/plans", json=open_task).json()["state"] == "queued"


def test_a_check_makes_no_plan(client: httpx.Client) -> None:
    before = client.get("/v1/plans").json()
    client.post("/v1/tasks/check", json=task())
    assert client.get("/v1/plans").json() == before


@pytest.mark.parametrize(("content", "status"), [(b"{", 400), (b"x" * 3_000_000, 413)])
def test_what_cannot_be_read_is_refused_as_everywhere(client: httpx.Client, content: bytes, status: int) -> None:
    answer = client.post("/v1/tasks/check", content=content, headers={"Content-Type": "application/json"})
    assert (answer.status_code, answer.headers["Content-Type"]) == (status, "application/problem+json")


@pytest.fixture
def guarded(tmp_path: Path) -> Iterator[tuple[str, dict[Scope, str]]]:
    settings = ServiceSettings.model_validate({"data_dir": tmp_path, "solver_command": FAKE_SOLVER, "worker_slots": 1})
    keys = {scope: issue_key(settings, "mes", scope, None) for scope in Scope}
    with served(settings) as address:
        yield address, keys


def test_who_may_look_may_check_and_leaves_no_entry_in_the_audit_log(guarded: tuple[str, dict[Scope, str]]) -> None:
    address, keys = guarded

    def as_(scope: Scope) -> httpx.Client:
        return httpx.Client(base_url=address, headers={"Authorization": f"Bearer {keys[scope]}"})

    with as_(Scope.READ) as reader, as_(Scope.ADMIN) as admin:
        before = admin.get("/v1/audit").json()["entries"]
        assert reader.post("/v1/tasks/check", json=task()).json()["accepted"] is True
        assert reader.post("/v1/plans", json=task()).status_code == 403
        entries = admin.get("/v1/audit").json()["entries"]
        assert [entry["target"] for entry in entries[: len(entries) - len(before)]] == ["/v1/plans"]
    assert httpx.post(f"{address}/v1/tasks/check", json=task()).status_code == 401
