"""Jobs that wait for their start are limited for each owner, and fill nobody's queue."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path

import httpx

from app.access.caller import Scope
from app.cli.keys_command import issue_key
from app.settings import ServiceSettings
from tests.support.service import FAKE_SOLVER, task
from tests.support.serving import served

MAX_QUEUED, MAX_DELAYED = 4, 3
LATER = "2999-01-01T00:00:00Z"


def post(client: httpx.Client, start: str | None = None) -> httpx.Response:
    return client.post("/v1/plans", json=task(), params={} if start is None else {"start_time": start})


def test_one_owners_jobs_for_later_are_limited_and_in_nobodys_way(tmp_path: Path) -> None:
    settings = ServiceSettings.model_validate(
        {"data_dir": tmp_path, "solver_command": FAKE_SOLVER, "max_queued": MAX_QUEUED, "max_delayed": MAX_DELAYED}
    )
    keys = [issue_key(settings, owner, Scope.WRITE, None) for owner in ("mes", "mes", "other")]
    with served(settings, with_worker=False) as address, ExitStack() as stack:
        first, second, other = (
            stack.enter_context(
                httpx.Client(base_url=address, headers={"Authorization": f"Bearer {key}"}, timeout=30.0)
            )
            for key in keys
        )
        delayed = [post(client, LATER) for client in (first, second, first)]
        assert [answer.status_code for answer in delayed] == [202] * MAX_DELAYED
        # Neither another key of the same owner helps, nor is anybody else held up.
        for client in (first, second):
            refused = post(client, LATER)
            assert (refused.status_code, refused.json()["title"]) == (429, "Too many jobs for later")
            assert "start_time" in refused.json()["detail"]
            assert int(refused.headers["Retry-After"]) > 0
        assert post(other, LATER).status_code == 202
        assert post(first, "2001-01-01T00:00:00Z").status_code == 202
        assert [post(client).status_code for client in (first, other, other)] == [202] * (MAX_QUEUED - 1)
        samples = first.get("/metrics").text.splitlines()
        assert {'liftwright_jobs{state="queued"} 4.0', 'liftwright_jobs{state="delayed"} 4.0'} <= set(samples)
        # Once it is full for now, later would be a way round.
        for start in (None, LATER):
            full = post(other, start)
            assert (full.status_code, full.json()["title"]) == (429, "Too many jobs")
        first.post(delayed[0].json()["links"]["cancel"]).raise_for_status()
        queued = next(plan for plan in other.get("/v1/plans").json()["plans"] if plan["start_time"] is None)
        other.post(queued["links"]["cancel"]).raise_for_status()
        assert post(second, LATER).status_code == 202
