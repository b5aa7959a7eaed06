"""Whether the service says that it cannot work, and says so no longer than it is true."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import httpx
import pytest
from support.service import FAKE_SOLVER, task, wait_for
from support.serving import served

from app.resources.plan_feed import PlanFeed
from app.settings import ServiceSettings
from workers.engine import supervisor, worker
from workers.engine.takeover import Takeover
from workers.engine.worker import Worker
from workers.webhooks.runner import WebhookRunner


def test_the_service_is_not_ready_while_anything_in_the_background_keeps_failing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    broken, loops = True, ((PlanFeed, "look"), (Takeover, "look"), (WebhookRunner, "look"))
    housekeeping = ((worker, name) for name in ("cancel_overdue", "count_failures", "delete_old"))

    def breakable(work: Callable[..., Any]) -> Callable[..., Any]:
        def wrapped(*arguments: Any) -> Any:
            if broken:
                raise ValueError("out of order")
            return work(*arguments)

        return wrapped

    for owner, name in (*loops, *housekeeping, (Worker, "_leave_lost_jobs")):
        monkeypatch.setattr(owner, name, breakable(getattr(owner, name)))
    monkeypatch.setattr(supervisor, "STUCK_SECONDS", 0.0)
    settings = ServiceSettings(
        data_dir=tmp_path, solver_command=FAKE_SOLVER, worker_slots=1, watch_seconds=0.1, retention_days=1.0
    )
    with served(settings) as address, httpx.Client(base_url=address) as client:
        names = {"feed", "jobs", "fleet", "webhooks", "expiry", "failures", "retention"}

        def told() -> str:
            answer = client.get("/readyz")
            return answer.json()["detail"] if answer.status_code == 503 else ""

        wait_for(lambda: all(name in told() for name in names), 20)
        broken = False
        # Nobody follows a plan: what looks for news has nothing to do well yet.
        plan = client.post("/v1/plans", json=task(external_id="now"), headers={"Prefer": "wait=20"}).json()
        assert plan["state"] == "succeeded"
        wait_for(lambda: told() == "", 20)
