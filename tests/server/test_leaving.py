"""A server that stops while somebody follows a plan."""

from __future__ import annotations

import logging
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import httpx
import pytest

from app.create_app import create_app
from app.settings import ServiceSettings
from tests.support.service import FAKE_SOLVER, task, wait_for
from tests.support.serving import answering


def test_who_follows_a_plan_is_answered_to_the_end_when_the_server_stops(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """A stream ends as a whole one does, `Prefer: wait` says how the plan stands, and no fault is told."""
    settings = ServiceSettings.model_validate({"data_dir": tmp_path, "solver_command": FAKE_SOLVER})
    app = create_app(settings, with_worker=False)
    with caplog.at_level(logging.WARNING), ThreadPoolExecutor(2) as threads, httpx.Client(timeout=60.0) as client:
        with answering(app, settings) as address:
            plans = f"{address}/v1/plans"
            plan_id = client.post(plans, json=task()).json()["id"]
            followed = threads.submit(client.get, f"{plans}/{plan_id}/events")
            waited = threads.submit(client.post, plans, json=task(), headers={"Prefer": "wait=60"})
            wait_for(lambda: app.state.followers._following.total() == 2)
        assert followed.result().status_code == 200
        assert waited.result().status_code == 202
    assert [record.getMessage() for record in caplog.records if record.name.startswith("uvicorn")] == []
