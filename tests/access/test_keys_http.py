"""Who may do what, over the wire."""

from __future__ import annotations

import json
import socket
import time
from typing import Any
from urllib.parse import urlsplit

import httpx
import pytest
from fastapi.routing import APIRoute, APIWebSocketRoute
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

from app.access.access_control import PUBLIC
from app.access.caller import Scope
from app.cli.keys_command import issue_key, list_keys, revoke_key
from app.create_app import PARTS
from app.resources.plan_collection import PlanCollection
from tests.access.conftest import GuardedService
from tests.support.scan_frames import shipped
from tests.support.service import task

PROBLEM = "application/problem+json"


def posted(client: httpx.Client, wish: str = "now", **headers: str) -> dict[str, Any]:
    answer = client.post("/v1/plans", json=task(external_id=wish), headers={"Prefer": "wait=20", **headers})
    assert answer.is_success, answer.text
    return answer.json()


def addresses() -> list[tuple[str, str]]:
    routes = [route for part in PARTS for route in part.router.routes if isinstance(route, APIRoute)]
    found = [(method, route.path) for route in routes for method in sorted(route.methods)]
    assert ("GET", "/v1/plans/{plan_id}/document") in found
    return [(method, path.replace("{", "").replace("}", "")) for method, path in found]


def test_without_a_key_nothing_is_answered_but_whether_the_service_lives(service: GuardedService) -> None:
    with service.client(None) as client:
        for method, path in [*addresses(), ("GET", "/openapi.json"), ("GET", "/v1/nothing"), ("HEAD", "/")]:
            answer = client.request(method, path, follow_redirects=False)
            if path in PUBLIC:
                assert answer.status_code in (200, 401), (method, path)
            else:
                assert answer.status_code == 401, (method, path)
                assert answer.headers["WWW-Authenticate"].startswith("Bearer"), (method, path)
                assert answer.headers["Content-Type"] == PROBLEM


def test_every_websocket_is_refused_without_a_key(service: GuardedService) -> None:
    routes = [route for part in PARTS for route in part.router.routes if isinstance(route, APIWebSocketRoute)]
    paths = [route.path.replace("{key}", "x") for route in routes]
    assert len(paths) == 3
    for path in paths:
        with pytest.raises(InvalidStatus) as refused, connect(service.address.replace("http", "ws") + path):
            pass
        assert refused.value.response.status_code == 403


@pytest.mark.parametrize(
    "header",
    [
        "Bearer",
        "Bearer x",
        "Basic bWVzOm1lcw==",
        "Bearer lwk_000000000000_" + "A" * 43,
        "Bearer " + "k" * 9000,
    ],
)
def test_what_is_no_key_opens_nothing(service: GuardedService, header: str) -> None:
    answer = httpx.get(f"{service.address}/v1/plans", headers={"Authorization": header})
    assert answer.status_code == 401


def test_a_key_with_another_secret_opens_nothing(service: GuardedService) -> None:
    wrong = service.keys["admin"][:-4] + ("aaaa" if not service.keys["admin"].endswith("aaaa") else "bbbb")
    answer = httpx.get(f"{service.address}/v1/plans", headers={"Authorization": f"Bearer {wrong}"})
    assert answer.status_code == 401
    assert "invalid_token" in answer.headers["WWW-Authenticate"]


def test_a_key_that_has_expired_opens_nothing(service: GuardedService) -> None:
    with service.client("expired") as client:
        assert client.get("/v1/plans").status_code == 401


@pytest.mark.slow
def test_a_revoked_key_opens_nothing_after_a_second(service: GuardedService) -> None:
    key = issue_key(service.settings, "mes", Scope.READ, None)
    headers = {"Authorization": f"Bearer {key}"}
    assert httpx.get(f"{service.address}/v1/plans", headers=headers).status_code == 200
    revoke_key(service.settings, key.split("_")[1])
    time.sleep(1.1)
    assert httpx.get(f"{service.address}/v1/plans", headers=headers).status_code == 401


@pytest.mark.parametrize("wish", [{"type": "open", "plan": "x"}, {"type": "open_perceived", "scene": "x"}])
@pytest.mark.slow
def test_a_websocket_opens_nothing_after_its_key_was_revoked(service: GuardedService, wish: dict[str, str]) -> None:
    key = issue_key(service.settings, "mes", Scope.READ, None)
    address = f"{service.address.replace('http', 'ws')}/viewer/watch"
    with connect(address, additional_headers={"Authorization": f"Bearer {key}"}) as socket:
        socket.recv(timeout=20)
        socket.send(json.dumps(wish))
        assert json.loads(socket.recv(timeout=20))["type"] == "refused", "there is none of that id, for who may ask"
        revoke_key(service.settings, key.split("_")[1])
        time.sleep(1.1)
        socket.send(json.dumps(wish))
        with pytest.raises(ConnectionClosed) as closed:
            socket.recv(timeout=20)
    assert closed.value.rcvd is not None
    assert closed.value.rcvd.code == 1008
    assert "log in" in closed.value.rcvd.reason


def test_a_reader_may_look_but_not_touch(service: GuardedService) -> None:
    with service.client("writer") as writer, service.client("reader") as reader:
        plan = posted(writer)
        assert reader.get(plan["links"]["self"]).status_code == 200
        assert reader.get(plan["links"]["document"]).status_code == 200
        refused = [
            reader.post("/v1/plans", json=task(external_id="now")),
            reader.post("/v1/meshes", content=b"", headers={"Content-Type": "model/stl"}),
            reader.post(plan["links"]["cancel"]),
            reader.delete(plan["links"]["self"]),
        ]
        assert [answer.status_code for answer in refused] == [403] * len(refused)
        assert all(answer.headers["Content-Type"] == PROBLEM for answer in refused)


@pytest.mark.slow
def test_a_reader_may_see_a_scene_but_have_none_perceived(service: GuardedService) -> None:
    scan = shipped()
    form = {"scan": json.dumps({"colour": scan.description["colour"]}).encode(), "colour": scan.files["colour"]}
    with service.client("writer") as writer, service.client("reader") as reader:
        assert reader.post("/v1/scenes", files=form).status_code == 403
        answer = writer.post("/v1/scenes", files=form)
        assert answer.status_code == 201, answer.text
        for link in answer.json()["links"].values():
            assert reader.get(link, follow_redirects=True).status_code == 200
            with service.client(None) as nobody:
                assert nobody.get(link).status_code == 401


def test_the_scene_of_somebody_else_does_not_exist(service: GuardedService) -> None:
    scan = shipped()
    form = {"scan": json.dumps({"colour": scan.description["colour"]}).encode(), "colour": scan.files["colour"]}
    with service.client("writer") as writer, service.client("stranger") as stranger, service.client("admin") as admin:
        mine, theirs = (client.post("/v1/scenes", files=form).json() for client in (writer, stranger))
        assert mine["id"] != theirs["id"]
        for link in mine["links"].values():
            assert stranger.get(link, follow_redirects=False).status_code == 404
            assert admin.get(link, follow_redirects=False).status_code in (200, 307)
        assert stranger.delete(mine["links"]["self"]).status_code == 404
        task_of_theirs = {"kind": "suction_tool", "scene_id": mine["id"], "objects": []}
        assert "/scene_id" in stranger.post("/v1/plans", json=task_of_theirs).text
        seen = {
            name: [each["id"] for each in client.get("/v1/scenes").json()["scenes"]]
            for name, client in (("writer", writer), ("stranger", stranger), ("admin", admin))
        }
        assert mine["id"] in seen["writer"]
        assert theirs["id"] not in seen["writer"]
        assert mine["id"] not in seen["stranger"]
        assert {mine["id"], theirs["id"]} <= set(seen["admin"])
        with service.client("reader") as reader:
            assert reader.delete(mine["links"]["self"]).status_code == 403
        assert writer.delete(mine["links"]["self"]).status_code == 204


def test_the_plan_of_somebody_else_does_not_exist(service: GuardedService) -> None:
    with service.client("writer") as writer, service.client("stranger") as stranger, service.client("admin") as admin:
        plan = posted(writer)
        for name in ("self", "document", "events", "view", "recording"):
            answer = stranger.get(plan["links"][name], follow_redirects=False)
            assert answer.status_code == 404, name
            assert answer.json() == stranger.get(plan["links"][name].replace(plan["id"], "0" * 32)).json() | {
                "detail": f"there is no plan {plan['id']!r}"
            }
        assert stranger.post(plan["links"]["cancel"]).status_code == 404
        assert stranger.delete(plan["links"]["self"]).status_code == 404
        assert plan["id"] not in [seen["id"] for seen in stranger.get("/v1/plans").json()["plans"]]
        assert plan["id"] in [seen["id"] for seen in writer.get("/v1/plans").json()["plans"]]
        assert plan["id"] in [seen["id"] for seen in admin.get("/v1/plans").json()["plans"]]


def test_two_owners_may_choose_the_same_idempotency_key(service: GuardedService) -> None:
    with service.client("writer") as writer, service.client("stranger") as stranger:
        headers = {"Idempotency-Key": "order-1"}
        mine, theirs = posted(writer, **headers), posted(stranger, "steps-1", **headers)
        assert mine["id"] != theirs["id"]
        assert posted(writer, **headers)["id"] == mine["id"]


def test_keys_of_one_owner_share_plans(service: GuardedService) -> None:
    second = issue_key(service.settings, "mes", Scope.WRITE, None)
    with service.client("writer") as writer:
        plan = posted(writer)
    answer = httpx.get(service.address + plan["links"]["self"], headers={"Authorization": f"bearer {second}"})
    assert answer.status_code == 200


def test_secrets_are_nowhere_in_the_data_directory(service: GuardedService) -> None:
    with service.client("writer") as writer:
        posted(writer)
    stored = b"".join(path.read_bytes() for path in service.settings.data_dir.rglob("*") if path.is_file())
    for key in service.keys.values():
        _, key_id, secret = key.split("_", 2)
        assert key_id.encode() in stored
        assert secret.encode() not in stored


def test_the_list_of_keys_has_no_secrets_but_states(service: GuardedService) -> None:
    listing = list_keys(service.settings)
    assert all(key.split("_", 2)[2] not in listing for key in service.keys.values())
    states = {line.split()[0]: line.split()[-1] for line in listing.splitlines()[1:]}
    assert states[service.keys["admin"].split("_")[1]] == "valid"
    assert states[service.keys["expired"].split("_")[1]] == "expired"


def test_the_audit_log_tells_an_admin_alone_who_changed_what(service: GuardedService) -> None:
    with service.client("writer") as writer, service.client("admin") as admin:
        plan = posted(writer)
        writer.delete(plan["links"]["self"])
        assert writer.get("/v1/audit").status_code == 403
        first = admin.get("/v1/audit", params={"page_size": 2}).json()
        key_id = service.keys["writer"].split("_")[1]
        told = [(entry["action"], entry["target"], entry["status"], entry["key_id"]) for entry in first["entries"]]
        assert told == [("DELETE", plan["links"]["self"], 204, key_id), ("POST", plan["links"]["self"], 202, key_id)]
        assert {entry["address"] for entry in first["entries"]} == {"127.0.0.1"}
        second = admin.get("/v1/audit", params={"before": first["next_before"]}).json()
        assert second["entries"][0]["number"] < first["entries"][-1]["number"]


def test_what_a_scope_forbids_is_in_the_audit_log(service: GuardedService) -> None:
    with service.client("reader") as reader, service.client("admin") as admin:
        reader.delete("/v1/plans/some")
        (entry,) = admin.get("/v1/audit", params={"page_size": 1}).json()["entries"]
        assert (entry["action"], entry["target"], entry["status"]) == ("DELETE", "/v1/plans/some", 403)


def test_what_a_fault_has_interrupted_is_in_the_audit_log(
    service: GuardedService, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object) -> None:
        raise RuntimeError("nobody has foreseen this")

    with service.client("writer") as writer, service.client("admin") as admin:
        plan = posted(writer)
        monkeypatch.setattr(PlanCollection, "delete", fail)
        assert writer.delete(plan["links"]["self"]).status_code == 500
        told = admin.get("/v1/audit", params={"page_size": 2}).json()["entries"]
        assert [(entry["action"], entry["status"]) for entry in told] == [("DELETE", 500), ("POST", 202)]


@pytest.mark.parametrize(
    ("path", "media_type"),
    [
        ("/v1/plans", "application/json"),
        ("/v1/meshes", "model/stl"),
        ("/v1/scenes", "multipart/form-data; boundary=x"),
    ],
)
def test_a_body_that_stops_coming_is_given_up(service: GuardedService, path: str, media_type: str) -> None:
    url = urlsplit(service.address)
    head = (
        f"POST {path} HTTP/1.1\r\nHost: {url.netloc}\r\nContent-Type: {media_type}\r\nContent-Length: 100\r\n"
        f"Authorization: Bearer {service.keys['writer']}\r\n\r\n{{"
    )
    with socket.create_connection((url.hostname, url.port), timeout=10) as connection:
        connection.sendall(head.encode())
        answer = connection.makefile("rb").read()
    assert answer.startswith(b"HTTP/1.1 408 ")
    assert PROBLEM.encode() in answer


def test_a_service_that_asks_for_keys_tells_who_has_one(service: GuardedService) -> None:
    with service.client("reader") as reader:
        assert reader.get("/v1/capabilities").json()["needs_key"] is True


def test_head_is_get_without_the_body_even_of_a_stream(service: GuardedService) -> None:
    with service.client("writer") as writer:
        plan = writer.post("/v1/plans", json=task(external_id="hang")).json()
        for path in (plan["links"]["self"], plan["links"]["events"], "/v1/plans", "/v1/capabilities", "/openapi.json"):
            answer = writer.head(path)
            assert (answer.status_code, answer.content) == (200, b""), path
        assert writer.head("/v1/plans/unknown").status_code == 404
        writer.post(plan["links"]["cancel"])
