"""What is asked for over HTTP and takes seconds: whatever becomes of it, the service answers."""

from __future__ import annotations

import gzip
import json
import socket
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import httpx
import psutil
import pytest

from app.resources.cell_collection import look_at, survey_shelf
from app.routes import cells, scenes
from app.settings import ServiceSettings
from app.viewer import scene_servers
from planners.cell.cell import load_cell
from planners.perception.perceive import perceive
from tests.support import works
from tests.support.lift_documents import lift_document
from tests.support.own_cell import station
from tests.support.scan_frames import shipped
from tests.support.service import finished, task, wait_for
from tests.support.serving import served

SCAN = shipped()
LIFT = "lift"


@pytest.fixture
def settings(tmp_path: Path) -> ServiceSettings:
    documents = tmp_path / "documents"
    documents.mkdir()
    (documents / f"{LIFT}.json").write_text(json.dumps(lift_document(load_cell("dual_ur3e_lift"))))
    solver = (sys.executable, "-m", "tests.support.document_solver", str(documents))
    return ServiceSettings(data_dir=tmp_path / "data", solver_command=solver, worker_slots=1, work_memory_mb=1024)


@pytest.fixture
def client(settings: ServiceSettings) -> Iterator[httpx.Client]:
    with served(settings) as address, httpx.Client(base_url=address, timeout=60.0) as client:
        yield client


def form(description: dict[str, Any]) -> dict[str, Any]:
    described = {"scan": ("scan.json", json.dumps(description).encode(), "application/json")}
    return described | {name: (name, content) for name, content in SCAN.files.items()}


def post(client: httpx.Client) -> httpx.Response:
    return client.post("/v1/scenes", files=form(SCAN.description))


def recording(client: httpx.Client) -> str:
    plan = finished(client, client.post("/v1/plans", json=task(external_id=LIFT)).json())
    return f"{plan['links']['self']}/recording.html"


@pytest.mark.parametrize(
    ("work", "status", "title"),
    [
        (works.grow, 422, "It takes too much memory"),
        (works.die, 503, "The work has ended without an answer"),
        (works.fail, 500, "Internal error"),
        (works.refuse, 422, "The task is not valid"),
    ],
)
@pytest.mark.slow
def test_a_scan_that_goes_wrong_is_answered_and_so_is_everybody_else_meanwhile(
    client: httpx.Client, monkeypatch: pytest.MonkeyPatch, work: Any, status: int, title: str
) -> None:
    monkeypatch.setattr(scenes, "perceive", work)
    with ThreadPoolExecutor(1) as pool:
        posted = pool.submit(post, client)
        while not posted.done():
            assert httpx.get(client.base_url.join("/livez"), timeout=10.0).status_code == 200
    answer = posted.result()
    assert (answer.status_code, answer.json()["title"]) == (status, title), answer.text
    monkeypatch.setattr(scenes, "perceive", perceive)
    assert post(client).status_code == 201


@pytest.mark.parametrize("what", ["scene", "recording"])
@pytest.mark.slow
def test_the_process_of_what_was_asked_for_is_gone_soon_after_who_has_asked(
    client: httpx.Client, settings: ServiceSettings, monkeypatch: pytest.MonkeyPatch, what: str
) -> None:
    told = settings.data_dir / "told"
    monkeypatch.setattr(scenes, "perceive", works.perceive_for_ever)
    monkeypatch.setattr(scene_servers, "recording_of_document", works.record_for_ever)
    if what == "scene":
        asked = client.build_request("POST", "/v1/scenes", files=form({**SCAN.description, "external_id": str(told)}))
    else:
        asked = client.build_request("GET", recording(client))
    with socket.create_connection((client.base_url.host, client.base_url.port)) as leaving:
        head = [
            f"{asked.method} {asked.url.path} HTTP/1.1",
            *(f"{name}: {said}" for name, said in asked.headers.items()),
        ]
        leaving.sendall("\r\n".join([*head, "", ""]).encode() + asked.read())
        process = int(wait_for(lambda: told.exists() and told.read_text()))
    wait_for(lambda: not psutil.pid_exists(process), 1.0)
    monkeypatch.undo()
    answer = client.get(asked.url) if what == "recording" else post(client)
    assert answer.status_code in (200, 201)


@pytest.mark.slow
def test_a_recording_is_the_same_page_wherever_it_is_made(client: httpx.Client, tmp_path: Path) -> None:
    path = recording(client)
    document = client.get(path.replace("recording.html", "document")).content
    here = scene_servers.recording_of_document(gzip.compress(document), load_cell("dual_ur3e_lift"), tmp_path / "here")
    assert client.get(path).text == here


@pytest.mark.slow
def test_a_cell_is_surveyed_in_a_process_of_its_own_and_once(
    client: httpx.Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = "/v1/cells/dual_ur3e_lift/survey"
    survey_shelf.cache_clear()
    monkeypatch.setattr(cells, "look_at", works.die)
    assert client.get(path).status_code == 503
    monkeypatch.undo()
    found = client.get(path)
    assert found.json() == look_at(load_cell("dual_ur3e_lift")).figures().model_dump(mode="json")
    monkeypatch.setattr(cells, "look_at", works.die)
    assert client.get(path).json() == found.json()


@pytest.mark.parametrize("path", ["/v1/cells", "/v1/surveys"])
@pytest.mark.slow
def test_a_cell_that_is_sent_is_examined_in_a_process_of_its_own(
    client: httpx.Client, monkeypatch: pytest.MonkeyPatch, path: str
) -> None:
    for work, status in ((works.grow, 422), (works.die, 503), (works.refuse, 422)):
        monkeypatch.setattr(cells, "examined_upload", work)
        assert client.post(path, json=station()).status_code == status
    monkeypatch.undo()
    assert client.get("/v1/cells/station").status_code == 404
    assert client.post(path, json=station()).is_success
