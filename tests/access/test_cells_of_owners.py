"""Two owners have a cell of one name: each one's name means their own, and an admin reaches both by their ids."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import httpx
import pytest
from websockets.sync.client import ClientConnection, connect

from app.access.caller import ANYBODY, Caller, Scope
from app.cli.keys_command import issue_key
from app.resources.cell_collection import CellCollection, examined
from planners.cell.bundle import CellBundle
from planners.cell.cell import ShippedCells
from tests.access.conftest import GuardedService
from tests.support.own_cell import station
from tests.support.own_service import sparing_repeats
from tests.support.service import finished, task
from workers.settings import WorkerSettings
from workers.stores.cell_store import CellStore
from workers.stores.database import open_database

TASK = task("pb1.json", plate_pose=[0.6, 0.0, 0.922, 1, 0, 0, 0], options={"simulate": False}, cell="station")
LOWER = 0.05
"""So much lower the stranger's table is [m]."""


@pytest.fixture(scope="module", autouse=True)
def _examined_once() -> Iterator[None]:
    with sparing_repeats():
        yield


def station_of(owner: str) -> dict[str, Any]:
    """Return a cell called `station`, by which its owner is known."""
    cell = station()
    if owner != "writer":
        cell["mount"]["table"]["center"][2] -= LOWER
    return cell


@pytest.fixture
def cells(service: GuardedService) -> dict[str, dict[str, Any]]:
    """Return the `station` of each of two owners; the stranger's was posted last."""
    posted = {}
    for name in ("writer", "stranger"):
        with service.client(name) as client:
            posted[name] = client.post("/v1/cells", json=station_of(name)).raise_for_status().json()
    assert posted["writer"]["id"] != posted["stranger"]["id"]
    return posted


@contextmanager
def editor(service: GuardedService, name: str) -> Iterator[ClientConnection]:
    headers = {"Authorization": f"Bearer {service.keys[name]}"}
    address = service.address.replace("http", "ws") + "/viewer/edit"
    with connect(address, additional_headers=headers, max_size=None) as socket:
        assert json.loads(socket.recv(timeout=60))["type"] == "scene"
        yield socket


def height_in_editor(socket: ClientConnection, cell: str) -> float | None:
    """Return how high the plate comes to lie in a cell [m]; None where no cell is shown."""
    drawn = {"type": "draw", "task": {**TASK, "cell": cell}, "chosen": "/plate_pose", "wrong": [], "moves": 0}
    socket.send(json.dumps(drawn))
    assert json.loads(socket.recv(timeout=60)) == {"type": "done", "request": "draw"}
    socket.send(json.dumps({"type": "nudge", "pointer": "/plate_pose", "by": [0.01, 0.0], "turn": 0.0}))
    told = json.loads(socket.recv(timeout=60))
    return told["value"][2] if told["type"] == "moved" else None


@pytest.mark.slow
def test_the_editor_shows_each_owner_their_own_cell_of_a_name(
    service: GuardedService, cells: dict[str, dict[str, Any]]
) -> None:
    heights = {}
    for name in cells:
        with editor(service, name) as socket:
            heights[name] = height_in_editor(socket, "station")
    assert heights["writer"] is not None
    assert heights["stranger"] == pytest.approx(heights["writer"] - LOWER)


def test_the_editor_shows_nobody_the_cell_of_another(service: GuardedService, cells: dict[str, dict[str, Any]]) -> None:
    with editor(service, "stranger") as socket:
        assert height_in_editor(socket, cells["writer"]["id"]) is None
    with editor(service, "admin") as socket:
        assert height_in_editor(socket, "station") is None
        assert height_in_editor(socket, cells["writer"]["id"]) is not None


def test_an_admin_reaches_the_cells_of_others_by_their_ids_alone(
    service: GuardedService, cells: dict[str, dict[str, Any]]
) -> None:
    with service.client("admin") as admin:
        assert admin.get("/v1/cells/station").status_code == 404
        assert admin.delete("/v1/cells/station").status_code == 404
        assert admin.post("/v1/plans", json=TASK).status_code == 422
        assert "station" not in admin.get("/v1/capabilities").raise_for_status().json()["cells"]
        listed = {each["id"] for each in admin.get("/v1/cells").json()["cells"]}
        assert {each["id"] for each in cells.values()} <= listed
        for cell in cells.values():
            assert admin.get(cell["links"]["self"]).json() == cell
    with service.client("writer") as writer:
        assert writer.get("/v1/cells/station").json()["id"] == cells["writer"]["id"]


def test_a_plan_in_the_cell_of_somebody_else_becomes_no_program_for_who_does_not_see_that_cell(
    service: GuardedService, cells: dict[str, dict[str, Any]]
) -> None:
    with service.client("admin") as admin:
        planned = {**TASK, "cell": cells["writer"]["id"]}
        plan = finished(admin, admin.post("/v1/plans", json=planned).raise_for_status().json())
    headers = {"Authorization": f"Bearer {issue_key(service.settings, 'it', Scope.WRITE, None)}"}
    answer = httpx.get(
        f"{service.address}/v1/plans/{plan['id']}/program.zip", params={"target": "csv"}, headers=headers
    )
    assert answer.status_code == 409, answer.text
    assert "somebody else" in answer.json()["detail"]


def test_without_keys_and_for_what_is_an_owners_a_name_is_looked_up_in_their_cells(tmp_path: Path) -> None:
    with closing(open_database(WorkerSettings(data_dir=tmp_path))) as database:
        everybodys = CellCollection(ShippedCells(), CellStore(database, tmp_path / "cells"))
        callers = {"writer": ANYBODY, "stranger": Caller("1", "other", Scope.WRITE)}
        ids = {}
        for name, caller in callers.items():
            bundle = CellBundle.of_text(json.dumps(station_of(name)).encode(), "cell.json")
            found = examined(bundle, everybodys.folder, everybodys.shipped)
            ids[name] = everybodys.seen_by(caller).add(bundle, found)[0].id
        assert everybodys.lasting_name("station") == ids["writer"]
        assert everybodys.of_owner("other").lasting_name("station") == ids["stranger"]
        assert set(ids.values()) <= set(filter(everybodys.of_owner("nobody").__contains__, ids.values()))
        assert "station" not in everybodys.of_owner("nobody")


def test_nobody_compares_cells_of_others(service: GuardedService, cells: dict[str, dict[str, Any]]) -> None:
    axis = {"pointer": "/cell", "values": ["dual_ur3e_lift", cells["writer"]["id"]]}
    with service.client("stranger") as client:
        refused = client.post("/v1/studies", json={"task": task("pb1.json"), "axes": [axis]})
    assert refused.status_code == 422
    assert [error["pointer"] for error in refused.json()["errors"]] == ["/axes/0/values/1"]
