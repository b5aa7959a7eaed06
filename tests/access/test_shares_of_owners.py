"""What one owner asks for does not keep others waiting, and leaves room for them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import httpx
import pytest

from app.access.caller import Scope
from app.cli.keys_command import issue_key
from app.settings import ServiceSettings
from tests.support.service import FAKE_EXAMINER, FAKE_SOLVER, finished, task
from tests.support.serving import served
from workers.stores.study_store import POINTS_PER_PART

SHARE = 4
PARTS = 6


@pytest.mark.slow
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


@pytest.mark.slow
def test_points_of_studies_that_are_planned_count_in_the_share_of_their_owner(tmp_path: Path) -> None:
    fakes = {"solver_command": FAKE_SOLVER, "study_command": FAKE_EXAMINER}
    limits = {"max_queued": 6, "max_queued_of_owner": 1, "worker_slots": 1}
    settings = ServiceSettings.model_validate({"data_dir": tmp_path, **fakes, **limits})
    key = {"Authorization": f"Bearer {issue_key(settings, 'greedy', Scope.WRITE, None)}"}
    with served(settings) as address, httpx.Client(base_url=address, timeout=90.0, headers=key) as client:
        body = {"task": task(external_id="now"), "axes": [{"pointer": "/cup/max_force", "values": [15, 20]}]}
        study = finished(client, client.post("/v1/studies", json=body).raise_for_status().json())
        finished(client, {"links": {"self": study["best_plan"]}})
        first = client.post("/v1/plans", json=task(external_id="hang")).raise_for_status().json()
        points = [f"{study['links']['points']}/{index}/plan" for index in range(2)]
        answers = [client.post(point) for point in points]
        # The best one has its plan.
        assert sorted(answer.status_code for answer in answers) == [200, 429]
        refused = next(answer for answer in answers if answer.status_code == 429)
        assert "1 of your jobs" in refused.json()["detail"]
        assert "Retry-After" in refused.headers
        client.post(first["links"]["cancel"]).raise_for_status()
        assert client.post(refused.request.url.path).status_code == 202


@pytest.mark.slow
def test_one_owners_studies_leave_room_for_another_and_take_turns_with_theirs(tmp_path: Path) -> None:
    fakes = {"solver_command": FAKE_SOLVER, "study_command": FAKE_EXAMINER}
    limits = {"max_studies": 3, "max_studies_of_owner": 2, "study_slots": 1}
    settings = ServiceSettings.model_validate({"data_dir": tmp_path, **fakes, **limits})
    greedy, patient = (
        {"Authorization": f"Bearer {issue_key(settings, owner, Scope.WRITE, None)}"} for owner in ("greedy", "patient")
    )
    many = [{"pointer": "/cup/max_force", "values": [15 + 0.1 * n for n in range(PARTS * POINTS_PER_PART)]}]
    with served(settings) as address, httpx.Client(base_url=address, timeout=90.0) as client:

        def post(key: dict[str, str], axes: list[dict[str, Any]]) -> httpx.Response:
            return client.post("/v1/studies", json={"task": task(external_id="now"), "axes": axes}, headers=key)

        answers = [post(greedy, many) for _ in range(3)]
        assert [answer.status_code for answer in answers] == [202, 202, 429]
        assert "2 of your studies" in answers[-1].json()["detail"]
        few = [{"pointer": "/cup/max_force", "values": [15, 16]}]
        client.headers.update(patient)
        finished(client, post(patient, few).raise_for_status().json())
        client.headers.update(greedy)
        left = [client.get(answer.json()["links"]["self"]).json() for answer in answers[:2]]
        assert not any(study["done"] for study in left)
