"""What heads of requests are believed, and what browsers are told of every answer."""

from __future__ import annotations

import socket
from pathlib import Path
from urllib.parse import urlsplit

import httpx
import pytest

from app.access.caller import Scope
from app.cli.keys_command import issue_key
from app.resources.plan_collection import PlanCollection
from app.settings import ServiceSettings
from tests.access.conftest import GuardedService
from tests.support.service import FAKE_SOLVER, wait_for
from tests.support.serving import served

ELSEWHERE = "203.0.113.9"


def settings_in(folder: Path, **settings: object) -> ServiceSettings:
    return ServiceSettings.model_validate({"data_dir": folder, "solver_command": FAKE_SOLVER, **settings})


def address_in_audit(folder: Path, **settings: object) -> str:
    """Return where a change came from, as the audit log has it, that a proxy says was made elsewhere."""
    guarded = settings_in(folder, **settings)
    key = {"Authorization": f"Bearer {issue_key(guarded, 'it', Scope.ADMIN, None)}"}
    with served(guarded, with_worker=False) as address, httpx.Client(base_url=address, headers=key) as client:
        assert client.delete("/v1/plans/none", headers={"X-Forwarded-For": ELSEWHERE}).status_code == 404
        return client.get("/v1/audit").json()["entries"][0]["address"]


@pytest.mark.slow
def test_what_says_to_be_a_proxy_is_believed_only_where_it_is_set(tmp_path: Path) -> None:
    assert address_in_audit(tmp_path / "a") == "127.0.0.1"
    assert address_in_audit(tmp_path / "b", trusted_proxies=["10.0.0.0/8"]) == "127.0.0.1"
    assert address_in_audit(tmp_path / "c", trusted_proxies=["127.0.0.0/8"]) == ELSEWHERE


def test_wrong_keys_are_counted_by_where_they_come_from_and_not_by_where_they_say(service: GuardedService) -> None:
    with service.client(None) as client:
        told = {
            client.get(
                "/v1/plans", headers={"Authorization": f"Bearer {n}", "X-Forwarded-For": f"10.0.{n % 250}.1"}
            ).status_code
            for n in range(150)
        }
    assert told == {401, 429}


@pytest.mark.parametrize(
    "path", ["/", "/docs", "/viewer/", "/viewer/new", "/viewer/compare", "/viewer/study", "/viewer/style.css",
             "/v1/plans", "/v1/plans/none", "/livez", "/viewer/login", "/none"],
)  # fmt: skip
def test_no_other_site_frames_or_guesses_any_answer(service: GuardedService, path: str) -> None:
    with service.client("admin") as client:
        assert_neither_framed_nor_guessed(client.get(path))


def test_nor_what_is_answered_where_nothing_else_is(service: GuardedService, monkeypatch: pytest.MonkeyPatch) -> None:
    """An error of ours, and what is no request."""

    def broken(*_: object) -> None:
        raise ValueError("out of order")

    monkeypatch.setattr(PlanCollection, "page", broken)
    with service.client("admin") as client:
        answer = client.get("/v1/plans", headers={"X-Request-ID": "order-7"})
    assert answer.status_code == 500
    assert answer.headers["X-Request-ID"] == "order-7"
    assert_neither_framed_nor_guessed(answer)
    head, _, body = sent(service, b"no request\r\n\r\n").decode().partition("\r\n\r\n")
    status, *lines = head.split("\r\n")
    assert status.startswith("HTTP/1.1 400 ")
    assert_neither_framed_nor_guessed(httpx.Response(400, headers=[line.split(": ", 1) for line in lines], text=body))


def assert_neither_framed_nor_guessed(answer: httpx.Response) -> None:
    headers = answer.headers
    assert "frame-ancestors 'self'" in headers["Content-Security-Policy"]
    assert headers["X-Frame-Options"] == "SAMEORIGIN"
    assert headers["X-Content-Type-Options"] == "nosniff"
    assert headers["Referrer-Policy"] == "same-origin"


def test_with_keys_a_service_on_loopback_answers_to_its_own_machine_or_to_the_names_that_are_set(
    service: GuardedService, tmp_path: Path
) -> None:
    with service.client("reader") as client:
        for host, status in {"localhost": 200, "evil.example": 421, "[": 421, "[::1": 421}.items():
            assert client.get("/v1/plans", headers={"Host": host}).status_code == status
            assert client.get("/livez", headers={"Host": host}).status_code == 200
    settings = settings_in(tmp_path, allowed_hosts=["mes-planner"])
    key = {"Authorization": f"Bearer {issue_key(settings, 'it', Scope.ADMIN, None)}"}
    with served(settings, with_worker=False) as address, httpx.Client(base_url=address, headers=key) as client:
        for host, status in {"MES-planner:8040": 200, "localhost": 421, "evil.example": 421, "[": 421}.items():
            answer = client.get("/v1/plans", headers={"Host": host})
            assert answer.status_code == status
            assert status == 200 or "mes-planner" in answer.json()["detail"]


def test_metrics_are_shown_without_a_key_where_that_is_set_and_nothing_else_is(tmp_path: Path) -> None:
    for shown in (False, True):
        settings = settings_in(
            tmp_path, authentication="required", allowed_hosts=["mes-planner"], metrics_without_key=shown
        )
        with served(settings, with_worker=False) as address, httpx.Client(base_url=address) as client:
            by_address = {"Host": "10.1.2.3:8040"}
            answer = client.get("/metrics", headers=by_address)
            assert answer.status_code == (200 if shown else 421)
            assert ("liftwright_jobs" in answer.text) == shown
            assert client.get("/metrics", headers={"Host": "mes-planner"}).status_code == (200 if shown else 401)
            assert client.post("/metrics", headers={"Host": "mes-planner"}).status_code == 401
            assert client.get("/v1/plans", headers={"Host": "mes-planner"}).status_code == 401
            assert client.get("/v1/plans", headers=by_address).status_code == 421


def sent(service: GuardedService, text: bytes, *, leave: bool = False) -> bytes:
    """Send bytes as they are, and return what comes until the service closes."""
    parts = urlsplit(service.address)
    with socket.create_connection((parts.hostname, parts.port)) as connection:
        connection.sendall(text)
        answer = b""
        while not leave and (part := connection.recv(4096)):
            answer += part
        return answer


def test_a_body_whose_end_is_told_in_two_ways_is_refused_and_nothing_behind_it_is_read(service: GuardedService) -> None:
    smuggled = (
        b"POST /v1/tasks/check HTTP/1.1\r\nHost: localhost\r\nContent-Length: 5\r\nTransfer-Encoding: chunked\r\n\r\n"
        b"0\r\n\r\nGET /livez HTTP/1.1\r\nHost: localhost\r\n\r\n"
    )
    answer = sent(service, smuggled)
    assert answer.startswith(b"HTTP/1.1 400 ")
    assert answer.count(b"HTTP/1.1 ") == 1


def test_a_client_that_leaves_in_the_middle_of_a_body_is_no_fault_of_the_service(
    service: GuardedService, capsys: pytest.CaptureFixture[str]
) -> None:
    head = f"POST /v1/plans HTTP/1.1\r\nHost: localhost\r\nAuthorization: Bearer {service.keys['writer']}\r\n"
    length = 'liftwright_request_seconds_count{method="POST",route="/v1/plans",status="%d"}'
    sent(service, f"{head}Content-Type: application/json\r\nContent-Length: 100\r\n\r\n{{".encode(), leave=True)
    with service.client("admin") as client:
        wait_for(lambda: length % 499 in client.get("/metrics").text, 5.0)
        assert length % 500 not in client.get("/metrics").text
    assert "Traceback" not in capsys.readouterr().err
