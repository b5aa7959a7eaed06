"""A browser shows a key once."""

from __future__ import annotations

import html
import re
from collections.abc import Iterator
from contextlib import contextmanager

import httpx
import pytest
from websockets.sync.client import connect

from tests.access.conftest import GuardedService

PAGE = {"Accept": "text/html,*/*"}


@contextmanager
def logged_in(service: GuardedService, name: str = "reader") -> Iterator[httpx.Client]:
    with service.client(None) as client:
        answer = client.post("/viewer/login", data={"key": service.keys[name], "next": "/viewer/?plan=x"})
        assert (answer.status_code, answer.headers["Location"]) == (303, "/viewer/?plan=x")
        yield client


def test_a_browser_is_sent_to_the_login_and_from_there_to_where_it_wanted(service: GuardedService) -> None:
    with service.client(None) as client:
        answer = client.get("/viewer/?plan=abc", headers=PAGE)
        assert answer.status_code == 303
        page = client.get(answer.headers["Location"])
        assert page.status_code == 200
        assert 'value="/viewer/?plan=abc"' in page.text


def test_the_cookie_opens_what_the_key_opens_and_no_more(service: GuardedService) -> None:
    with logged_in(service) as client:
        assert client.get("/viewer/").status_code == client.get("/v1/plans").status_code == 200
        assert client.post("/v1/plans", json={}).status_code == 403
        cookie = "; ".join(f"{name}={value}" for name, value in client.cookies.items())
        headers = {"Cookie": cookie}
        with connect(f"{service.address.replace('http', 'ws')}/viewer/watch", additional_headers=headers) as socket:
            assert '"scene"' in socket.recv(timeout=20)


@pytest.mark.parametrize("address", ["/v1/audit", "/v1/plans/none/view", "/viewer/nothing"])
def test_what_a_key_does_not_open_is_a_page_for_a_person_that_leads_to_where_another_is_shown(
    service: GuardedService, address: str
) -> None:
    with logged_in(service) as client:
        problem, page = client.get(address), client.get(address, headers=PAGE)
        assert problem.headers["content-type"] == "application/problem+json"
        assert page.headers["content-type"].startswith("text/html")
        assert page.status_code == problem.status_code == (403 if address == "/v1/audit" else 404)
        assert html.escape(problem.json()["detail"]) in page.text
        (sign_in,) = re.findall(r'href="(/viewer/login[^"]*)"', page.text)
        assert f'value="{address}"' in client.get(html.unescape(sign_in)).text


def test_the_cookie_is_out_of_reach_of_scripts_and_other_sites_and_is_not_the_key(service: GuardedService) -> None:
    with service.client(None) as client:
        answer = client.post("/viewer/login", data={"key": service.keys["reader"]})
        cookie = answer.headers["Set-Cookie"]
        assert "HttpOnly" in cookie
        assert "samesite=lax" in cookie.lower()
        assert service.keys["reader"].split("_", 2)[2] not in cookie
        stored = b"".join(path.read_bytes() for path in service.settings.data_dir.rglob("*") if path.is_file())
        assert client.cookies["liftwright"].encode() not in stored


@pytest.mark.parametrize("name", ["reader", "writer"])
def test_after_the_logout_the_cookie_opens_nothing(service: GuardedService, name: str) -> None:
    with logged_in(service, name) as client:
        cookies = dict(client.cookies)
        assert client.post("/viewer/logout").status_code == 303
        assert httpx.get(f"{service.address}/v1/plans", cookies=cookies).status_code == 401
    with service.client("admin") as admin:
        (entry,) = admin.get("/v1/audit", params={"page_size": 1}).json()["entries"]
    assert (entry["action"], entry["status"]) == ("POST", 303)
    assert entry["key_id"] == service.keys[name].split("_")[1]


def test_a_wrong_key_gives_no_cookie(service: GuardedService) -> None:
    with service.client(None) as client:
        answer = client.post("/viewer/login", data={"key": "guess"})
        assert answer.status_code == 401
        assert "Set-Cookie" not in answer.headers


@pytest.mark.parametrize(
    "wanted",
    ["https://evil.example/", "//evil.example/", "/\\evil.example", "\t//evil.example", "javascript:x", "//[", ""],
)
def test_the_login_leads_nowhere_else(service: GuardedService, wanted: str) -> None:
    with service.client(None) as client:
        answer = client.post("/viewer/login", data={"key": service.keys["reader"], "next": wanted})
        assert answer.headers["Location"] == "/viewer/"


def test_a_link_to_what_is_no_address_shows_the_login_that_leads_to_the_viewer(service: GuardedService) -> None:
    page = httpx.get(f"{service.address}/viewer/login", params={"next": "//["})
    assert page.status_code == 200
    assert 'value="/viewer/"' in page.text


def test_what_a_link_puts_into_the_login_page_stays_text(service: GuardedService) -> None:
    page = httpx.get(f"{service.address}/viewer/login", params={"next": '/"><script>alert(1)</script>'})
    assert "<script>" not in page.text


def test_a_page_of_another_site_cannot_use_the_cookie(service: GuardedService) -> None:
    with logged_in(service, "writer") as client:
        for origin in ("https://evil.example", "http://[", "null"):
            assert client.post("/v1/plans", json={}, headers={"Origin": origin}).status_code == 403, origin
        assert client.post("/v1/plans", json={}, headers={"Origin": service.address}).status_code == 422
