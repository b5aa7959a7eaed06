"""How often, how much, and who is let in without a key."""

from __future__ import annotations

import json
import time
from contextlib import ExitStack
from pathlib import Path

import httpx
import pytest
import viser
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect
from websockets.sync.connection import Connection
from websockets.typing import Subprotocol

from app.access.caller import Scope
from app.access.rate_limiter import RateLimiter
from app.cli.keys_command import NoSuchKey, issue_key, revoke_key
from app.serve import NoKeys, serve
from app.settings import ServiceSettings
from app.viewer.scene_servers import MOST_RELAYS
from tests.support.service import FAKE_SOLVER, task, wait_for
from tests.support.serving import served


def settings_in(folder: Path, **settings: object) -> ServiceSettings:
    return ServiceSettings.model_validate({"data_dir": folder, "solver_command": FAKE_SOLVER, **settings})


def test_a_bucket_lets_through_its_burst_and_then_its_rate() -> None:
    now = [0.0]
    limiter = RateLimiter(2.0, 3, clock=lambda: now[0])
    assert [limiter.take("a") for _ in range(4)] == [0.0, 0.0, 0.0, 0.5]
    assert limiter.take("b") == 0.0
    now[0] = 0.5
    assert limiter.take("a") == 0.0
    assert limiter.take("a") == pytest.approx(0.5)
    now[0] = 100.0
    assert [limiter.take("a") for _ in range(4)] == [0.0, 0.0, 0.0, 0.5]


def test_a_key_that_is_used_too_often_is_told_when_to_come_again_and_others_are_not(tmp_path: Path) -> None:
    settings = settings_in(tmp_path, requests_per_second=0.5, request_burst=3)
    busy, other = (issue_key(settings, "mes", Scope.READ, None) for _ in range(2))
    with served(settings, with_worker=False) as address:
        headers = {"Authorization": f"Bearer {busy}"}
        answers = [httpx.get(f"{address}/v1/plans", headers=headers) for _ in range(4)]
        assert [answer.status_code for answer in answers] == [200, 200, 200, 429]
        assert 1 <= int(answers[-1].headers["Retry-After"]) <= 2
        assert answers[-1].headers["Content-Type"] == "application/problem+json"
        assert httpx.get(f"{address}/v1/plans", headers={"Authorization": f"Bearer {other}"}).status_code == 200


def test_guessing_keys_is_slowed_down_but_good_keys_from_there_are_not(tmp_path: Path) -> None:
    settings = settings_in(tmp_path)
    key = issue_key(settings, "mes", Scope.READ, None)
    with served(settings, with_worker=False) as address, httpx.Client(base_url=address) as client:
        told = {client.get("/v1/plans", headers={"Authorization": f"Bearer {n}"}).status_code for n in range(150)}
        assert told == {401, 429}
        assert client.get("/v1/plans", headers={"Authorization": f"Bearer {key}"}).status_code == 200


def test_one_owner_neither_has_all_scenes_nor_is_sent_one_without_end(tmp_path: Path) -> None:
    settings = settings_in(tmp_path, max_watchers=4, max_watchers_of_owner=2)
    keys = [issue_key(settings, owner, Scope.READ, None) for owner in ("mes", "mes", "other")]
    with served(settings, with_worker=False) as address, ExitStack() as open_pages:

        def opened(path: str, key: str) -> Connection:
            headers = {"Authorization": f"Bearer {key}"}
            protocols = [Subprotocol(f"viser-v{viser.__version__}")] if "scene" in path else None
            url = address.replace("http", "ws") + path
            return open_pages.enter_context(connect(url, additional_headers=headers, subprotocols=protocols))

        def refusal(path: str, key: str) -> int:
            with pytest.raises((ConnectionClosed, InvalidStatus)) as closed:
                opened(path, key).recv(timeout=20)
            error = closed.value
            if isinstance(error, InvalidStatus):
                return error.response.status_code
            assert error.rcvd is not None
            return error.rcvd.code

        pages = [opened("/viewer/watch", keys[0]), opened("/viewer/edit", keys[1])]
        scene, _ = [json.loads(page.recv(timeout=20))["scene"] for page in pages]
        assert refusal("/viewer/watch", keys[1]) == 1013
        assert json.loads(opened("/viewer/watch", keys[2]).recv(timeout=20))["type"] == "scene"
        for _ in range(MOST_RELAYS):
            opened(f"/viewer/{scene}".rstrip("/"), keys[0])
        assert refusal(f"/viewer/{scene}".rstrip("/"), keys[0]) in (403, 1013)
        pages[0].close()
        wait_for(lambda: not is_refused(address, keys[1]), 10.0)


def is_refused(address: str, key: str) -> bool:
    """Tell whether whoever wants to watch is turned away."""
    headers = {"Authorization": f"Bearer {key}"}
    with connect(f"{address.replace('http', 'ws')}/viewer/watch", additional_headers=headers) as page:
        try:
            return json.loads(page.recv(timeout=20))["type"] != "scene"
        except ConnectionClosed:
            return True


def test_one_owner_does_not_follow_without_end_and_who_would_wait_is_answered_at_once(tmp_path: Path) -> None:
    settings = settings_in(tmp_path, max_followers=3, max_followers_of_owner=2)
    keys = {owner: issue_key(settings, owner, Scope.WRITE, None) for owner in ("mes", "other", "third")}
    with served(settings, with_worker=False) as address, ExitStack() as followed:

        def client(owner: str) -> httpx.Client:
            headers = {"Authorization": f"Bearer {keys[owner]}"}
            return followed.enter_context(httpx.Client(base_url=address, headers=headers, timeout=20.0))

        plans = {owner: client(owner).post("/v1/plans", json=task()).json()["links"]["events"] for owner in keys}

        def follow(owner: str) -> httpx.Response:
            return followed.enter_context(client(owner).stream("GET", plans[owner]))

        mine = [follow("mes") for _ in range(3)]
        assert [each.status_code for each in mine] == [200, 200, 429]
        assert mine[-1].headers["Content-Type"] == "application/problem+json"
        assert int(mine[-1].headers["Retry-After"]) > 0
        begun = time.monotonic()
        answer = client("mes").post("/v1/plans", json=task(), headers={"Prefer": "wait=15"})
        assert answer.status_code == 202
        assert time.monotonic() - begun < 10.0
        # One owner leaves room for another, but all together do not take every place.
        assert [follow(owner).status_code for owner in ("other", "third")] == [200, 429]
        mine[0].close()
        wait_for(lambda: follow("mes").status_code == 200, 10.0)


def test_without_keys_the_service_answers_to_its_own_machine_alone(tmp_path: Path) -> None:
    with served(settings_in(tmp_path), with_worker=False) as address, httpx.Client(base_url=address) as client:
        for host, status in {"localhost:1": 200, "[::1]": 200, "evil.example": 421, "": 421}.items():
            assert client.get("/v1/plans", headers={"Host": host}).status_code == status, host


def test_keys_can_be_asked_for_on_loopback_before_there_are_any(tmp_path: Path) -> None:
    with served(settings_in(tmp_path, authentication="required"), with_worker=False) as address:
        assert httpx.get(f"{address}/v1/plans").status_code == 401


@pytest.mark.parametrize("ends", ["revoked", "expired"])
def test_keys_are_asked_for_when_the_last_one_opens_nothing_any_more(tmp_path: Path, ends: str) -> None:
    settings = settings_in(tmp_path)
    key = issue_key(settings, "mes", Scope.READ, -1.0 if ends == "expired" else None)
    if ends == "revoked":
        revoke_key(settings, key.split("_")[1])
    with served(settings, with_worker=False) as address:
        assert httpx.get(f"{address}/v1/plans").status_code == 401
        another = {"Authorization": f"Bearer {issue_key(settings, 'mes', Scope.READ, None)}"}
        assert httpx.get(f"{address}/v1/plans", headers=another).status_code == 200


def test_a_public_address_is_refused_without_a_key(tmp_path: Path) -> None:
    settings = settings_in(tmp_path, host="0.0.0.0")
    with pytest.raises(NoKeys, match="keys issue"):
        serve(settings, with_worker=False)
    revoke_key(settings, issue_key(settings, "mes", Scope.READ, None).split("_")[1])
    issue_key(settings, "mes", Scope.READ, -1.0)
    with pytest.raises(NoKeys):
        serve(settings, with_worker=False)


def test_a_key_that_is_not_there_cannot_be_revoked(tmp_path: Path) -> None:
    with pytest.raises(NoSuchKey):
        revoke_key(settings_in(tmp_path), "0" * 12)
