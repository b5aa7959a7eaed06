"""An id that nothing can have is as little there as any other, on either database, and asking for it is kept."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any
from urllib.parse import unquote

import httpx
import pytest

from app.access.caller import Scope
from app.cli.keys_command import issue_key
from app.settings import ServiceSettings
from tests.support.places import on_one_or_both_databases
from tests.support.service import FAKE_SOLVER, ROOT, task
from tests.support.serving import served

ASKED = {"/v1/plans/{plan_id}/program.zip": {"target": "ur"}}
"""What must be asked beside the id."""
IDS = ("%00", "a%00b", "x" * 200, "%F0%9F%A4%96", "%0A", "%FF", "unknown")
PROBLEM = "application/problem+json"
pytestmark = on_one_or_both_databases


def operations_on_one() -> list[tuple[str, str]]:
    """All methods and paths with an id, of the description that is checked in."""
    paths = json.loads((ROOT / "docs" / "openapi.json").read_text())["paths"]
    return [(method.upper(), path) for path, known in paths.items() if "{" in path for method in known]


@pytest.fixture(scope="module")
def client(place: dict[str, str], tmp_path_factory: pytest.TempPathFactory) -> Iterator[httpx.Client]:
    settings = ServiceSettings.model_validate(
        {"data_dir": tmp_path_factory.mktemp("data"), "solver_command": FAKE_SOLVER, **place}
    )
    headers = {"Authorization": f"Bearer {issue_key(settings, 'it', Scope.ADMIN, None)}"}
    with (
        served(settings, with_worker=False) as address,
        httpx.Client(base_url=address, headers=headers, timeout=30.0) as client,
    ):
        yield client


@pytest.mark.parametrize(("method", "path"), operations_on_one())
def test_it_is_not_found(client: httpx.Client, method: str, path: str) -> None:
    name = path[path.index("{") : path.index("}") + 1]
    for given in IDS:
        answer = client.request(method, path.replace(name, given).replace("{index}", "0"), params=ASKED.get(path, {}))
        assert (answer.status_code, answer.headers["Content-Type"]) == (404, PROBLEM), given
        assert answer.json()["status"] == 404


@pytest.mark.parametrize("given", IDS)
def test_a_webhook_of_that_id_cannot_be_named(client: httpx.Client, given: str) -> None:
    answer = client.post(f"/v1/plans?webhook={given}", json=task())
    assert (answer.status_code, answer.headers["Content-Type"]) == (422, PROBLEM)
    assert [problem["pointer"] for problem in answer.json()["errors"]] == ["/query/webhook"]


@pytest.mark.parametrize("member", ["scene_id", "upload"])
@pytest.mark.parametrize("given", IDS)
def test_neither_can_a_scene_or_a_mesh(client: httpx.Client, member: str, given: str) -> None:
    body: dict[str, Any] = task("domino_pile.json")
    if member == "scene_id":
        body["scene_id"] = unquote(given)
    else:
        body["objects"][0]["shape"] = {"type": "mesh", "upload": unquote(given)}
    answer = client.post("/v1/plans", json=body)
    assert (answer.status_code, answer.headers["Content-Type"]) == (422, PROBLEM)


def test_whoever_asks_to_change_it_is_in_the_audit_log(client: httpx.Client) -> None:
    assert client.delete("/v1/plans/a%00b").status_code == 404
    newest = client.get("/v1/audit").raise_for_status().json()["entries"][0]
    assert (newest["action"], newest["status"]) == ("DELETE", 404)
    assert newest["target"] == "/v1/plans/a\N{REPLACEMENT CHARACTER}b"
