"""Cells of one's own over HTTP: added, looked at, planned in, owned, deleted."""

from __future__ import annotations

import io
import json
import time
import zipfile
from collections.abc import Iterator
from typing import Any

import cv2
import httpx
import numpy as np
import pytest

from planners.cell.cell import known_cells, load_cell
from tests.support.own_cell import station, station_files, written, zipped
from tests.support.own_service import sparing_repeats
from tests.support.service import task

ZIP = {"Content-Type": "application/zip"}
TASK = task("pb1.json", plate_pose=[0.6, 0.0, 0.922, 1, 0, 0, 0], options={"simulate": False})


@pytest.fixture(scope="module", autouse=True)
def _examined_once() -> Iterator[None]:
    with sparing_repeats():
        yield


def add(client: httpx.Client, description: dict[str, Any] | None = None) -> dict[str, Any]:
    answer = client.post("/v1/cells", json=description or station())
    assert answer.status_code in (200, 201), answer.text
    return answer.json()


def ended(client: httpx.Client, plan: dict[str, Any]) -> dict[str, Any]:
    for _ in range(300):
        plan = client.get(plan["links"]["self"]).json()
        if plan["done"]:
            return plan
        time.sleep(0.1)
    raise AssertionError(plan)


def same(cell: dict[str, Any]) -> dict[str, Any]:
    """Leave out what every post changes."""
    return {name: value for name, value in cell.items() if name != "created_at"}


@pytest.mark.slow
def test_a_cell_comes_as_a_document_a_zip_or_a_form_and_is_the_same_one(client: httpx.Client) -> None:
    content = zipped(station_files())
    first = client.post("/v1/cells", content=content, headers=ZIP)
    assert first.status_code == 201, first.text
    cell = first.json()
    assert first.headers["location"] == cell["links"]["self"] == f"/v1/cells/{cell['id']}"
    assert client.get(cell["links"]["self"]).json() == cell
    again = client.post("/v1/cells", content=content, headers=ZIP)
    form = client.post("/v1/cells", files={"file": ("station.zip", content, "application/octet-stream")})
    for answer in (again, form):
        assert (answer.status_code, same(answer.json())) == (200, same(cell))
    # As one document it says the same, in other files.
    whole = add(client)
    assert (whole["hash"], whole["name"]) == (cell["hash"], cell["name"])
    assert whole["version"] == cell["version"] + 1
    yaml = client.post("/v1/cells", content=written(station()), headers={"Content-Type": "application/yaml"})
    assert same(yaml.json()) == same(whole)


@pytest.mark.slow
def test_what_was_taken_otherwise_is_noted_for_whoever_asks_for_the_cell(client: httpx.Client) -> None:
    files = {"cell.yaml": written(station(name="noted")), "as built.pdf": b""}
    noted = client.post("/v1/cells", content=zipped(files), headers=ZIP).json()
    assert [note.partition(":")[0] for note in noted["notes"]] == ["'as built.pdf' is left out"]
    assert client.get(noted["links"]["self"]).json()["notes"] == noted["notes"]
    assert client.get(noted["links"]["survey"]).json()["notes"] == noted["notes"]
    checked = client.post("/v1/surveys", content=zipped(files), headers=ZIP).json()
    assert checked["notes"] == noted["notes"]
    shipped = client.get("/v1/cells/dual_ur3e_lift").json()
    assert shipped["notes"] is None
    assert client.get(shipped["links"]["survey"]).json()["notes"] == []


def test_a_cell_is_listed_with_the_shipped_ones_and_its_files_come_back(client: httpx.Client) -> None:
    cell = add(client)
    listed = client.get("/v1/cells").json()["cells"]
    assert [each["name"] for each in listed[: len(known_cells())]] == sorted(known_cells())
    assert cell["id"] in [each["id"] for each in listed]
    assert cell["name"] in client.get("/v1/capabilities").json()["cells"]
    files = client.get(cell["links"]["files"])
    with zipfile.ZipFile(io.BytesIO(files.content)) as archive:
        assert json.loads(archive.read("cells/station.yaml"))["name"] == "station"
    again = client.post("/v1/cells", content=files.content, headers=ZIP)
    assert again.json()["id"] == cell["id"]


@pytest.mark.parametrize("which", ["own", "dual_ur3e_tool"])
def test_a_cell_is_surveyed_in_figures_and_as_a_picture(client: httpx.Client, which: str) -> None:
    cell = add(client) if which == "own" else client.get(f"/v1/cells/{which}").json()
    figures = client.get(cell["links"]["survey"]).json()
    assert figures["hash"] == cell["hash"]
    if which == "own":
        assert figures == cell["figures"]
        assert client.post("/v1/surveys", json=station()).json() == figures
    assert all(0.0 < arm["reached"] <= 1.0 for arm in figures["arms"].values())
    picture = client.get(cell["links"]["picture"])
    image = cv2.imdecode(np.frombuffer(picture.content, np.uint8), cv2.IMREAD_COLOR)
    assert image is not None
    assert min(image.shape[:2]) > 300


@pytest.mark.slow
def test_a_task_names_a_cell_by_name_or_id_and_keeps_the_version_that_it_meant(client: httpx.Client) -> None:
    first = add(client)
    plans = [client.post("/v1/plans", json={**TASK, "cell": name}) for name in (first["name"], first["id"])]
    assert [plan.status_code for plan in plans] == [202, 202], plans[0].text
    moved = station(gravity=[0, 0, -9.8])
    second = add(client, moved)
    assert (second["name"], second["id"] != first["id"], second["version"]) == ("station", True, first["version"] + 1)
    plans.append(client.post("/v1/plans", json={**TASK, "cell": "station"}))
    named = []
    for plan in plans:
        links = ended(client, plan.json())["links"]
        named.append(client.get(links["document"]).json()["task"]["cell"])
    assert named == [first["id"], first["id"], second["id"]]


def test_a_study_may_be_of_ones_own_cell(client: httpx.Client) -> None:
    cell = add(client)
    axes = [{"pointer": "/cup/max_force", "values": [20.0, 30.0]}]
    study = client.post("/v1/studies", json={"task": {**TASK, "cell": "station"}, "axes": axes})
    assert study.status_code == 202, study.text
    assert client.get(f"{study.json()['links']['self']}/map").json()["task"]["cell"] == cell["id"]
    client.post(study.json()["links"]["cancel"])


@pytest.mark.slow
def test_a_deleted_cell_is_gone_for_tasks_and_stays_for_plans(client: httpx.Client) -> None:
    cell = add(client, station(name="short_lived"))
    plan = ended(client, client.post("/v1/plans", json={**TASK, "cell": cell["id"]}).json())
    assert client.delete(cell["links"]["self"]).status_code == 204
    assert client.get(cell["links"]["self"]).status_code == 404
    assert client.delete(cell["links"]["self"]).status_code == 404
    for name in (cell["id"], "short_lived"):
        refused = client.post("/v1/plans", json={**TASK, "cell": name})
        assert refused.status_code == 422
        (problem,) = refused.json()["errors"]
        assert problem["pointer"] == "/cell"
        # A lift is planned where an arm has a stick.
        shipped = {each for each in known_cells() if load_cell(each).pusher_arms}
        assert set(problem["allowed"]) & set(known_cells()) == shipped
    assert client.get(plan["links"]["document"]).status_code == 200
    assert client.get(plan["links"]["self"]).json()["state"] == "succeeded"
    back = add(client, station(name="short_lived"))
    assert back["id"] == cell["id"]
    assert client.post("/v1/plans", json={**TASK, "cell": "short_lived"}).status_code == 202


def test_everything_that_is_wrong_is_told_with_file_and_member(client: httpx.Client) -> None:
    files = station_files()
    mount = json.loads(files["mounts/station_mount.yaml"])
    mount["table"]["size"] = [1.2, -2.0, 0.04]
    mount["arms"]["left"].pop("home_deg")
    answer = client.post(
        "/v1/cells", content=zipped({**files, "mounts/station_mount.yaml": written(mount)}), headers=ZIP
    )
    assert (answer.status_code, answer.headers["content-type"]) == (422, "application/problem+json")
    told = {(each["file"], each["pointer"]) for each in answer.json()["errors"]}
    assert told == {
        ("mounts/station_mount.yaml", "/table/size/1"),
        ("mounts/station_mount.yaml", "/arms/left/home_deg"),
    }
    assert "/" not in answer.json()["detail"].replace("/table", "")


@pytest.mark.parametrize(
    ("content", "media", "status"),
    [
        (b"PK", "application/zip", 422),
        (b"name: [", "application/yaml", 422),
        (b"{}", "application/json", 422),
        (b"x", "text/plain", 415),
        (written(station(name="dual_ur3e_lift")), "application/json", 409),
        (zipped({"../out.yaml": b"", "cell.yaml": written(station())}), "application/zip", 422),
    ],
)
def test_what_is_no_cell_is_refused(client: httpx.Client, content: bytes, media: str, status: int) -> None:
    for path in ("/v1/cells", "/v1/surveys"):
        answer = client.post(path, content=content, headers={"Content-Type": media})
        assert answer.status_code == status, answer.text
        assert answer.headers["content-type"] == "application/problem+json"


@pytest.mark.parametrize("way", ["", "/files.zip", "/survey", "/survey.png"])
def test_a_cell_that_there_is_not_is_not_found(client: httpx.Client, way: str) -> None:
    assert client.get(f"/v1/cells/nowhere{way}").status_code == 404
    if way == "/files.zip":
        assert client.get(f"/v1/cells/dual_ur3e_lift{way}").status_code == 404
        assert client.delete("/v1/cells/dual_ur3e_lift").status_code == 404
