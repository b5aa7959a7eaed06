"""What one owner asks for does not keep others waiting, and leaves room for them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import httpx
from support.service import FAKE_SOLVER, finished, task
from support.serving import served

from app.access.caller import Scope
from app.cli.keys_command import issue_key
from app.settings import ServiceSettings

SHARE = 4


def test_an_owner_with_a_full_share_keeps_nobody_from_the_queue_nor_from_the_worker(tmp_path: Path) -> None:
    limits = {"max_queued": 6, "max_queued_of_owner": SHARE, "worker_slots": 1, "solver_command": FAKE_SOLVER}
    settings = ServiceSettings.model_validate({"data_dir": tmp_path, **limits})
    greedy, patient = (
        {"Authorization": f"Bearer {issue_key(settings, owner, Scope.WRITE, None)}"} for owner in ("greedy", "patient")
    )
    with served(settings) as address, httpx.Client(base_url=address, timeout=30.0) as client:

        def post(key: dict[str, str], priority: int) -> httpx.Response:
            return client.post(
                "/v1/plans", json=task(external_id="steps-10"), headers=key, params={"priority": priority}
            )

        answers = [post(greedy, 9) for _ in range(SHARE + 1)]
        assert [answer.status_code for answer in answers] == [202] * SHARE + [429]
        assert f"{SHARE} of your jobs" in answers[-1].json()["detail"]
        assert "Retry-After" in answers[-1].headers
        waits = post(patient, 0)
        assert waits.status_code == 202
        assert waits.json()["queue_position"] <= 2
        client.headers.update(patient)
        ended: dict[str, Any] = finished(client, waits.json())
        client.headers.update(greedy)
        last = [client.get(answer.json()["links"]["self"]).json() for answer in answers[1:SHARE]]
        assert sum(plan["done"] for plan in last) <= 1
        assert ended["state"] == "succeeded"
