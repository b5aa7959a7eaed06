"""How often, how much, and who is let in without a key."""

from __future__ import annotations

from pathlib import Path

import httpx
import pytest
from support.service import FAKE_SOLVER
from support.serving import served

from app.access.caller import Scope
from app.access.rate_limiter import RateLimiter
from app.cli.keys_command import NoSuchKey, issue_key, revoke_key
from app.serve import NoKeys, serve
from app.settings import ServiceSettings


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


def test_without_keys_the_service_answers_to_its_own_machine_alone(tmp_path: Path) -> None:
    with served(settings_in(tmp_path), with_worker=False) as address, httpx.Client(base_url=address) as client:
        for host, status in {"localhost:1": 200, "[::1]": 200, "evil.example": 421, "": 421}.items():
            assert client.get("/v1/plans", headers={"Host": host}).status_code == status, host


def test_keys_can_be_asked_for_on_loopback_before_there_are_any(tmp_path: Path) -> None:
    with served(settings_in(tmp_path, authentication="required"), with_worker=False) as address:
        assert httpx.get(f"{address}/v1/plans").status_code == 401


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
