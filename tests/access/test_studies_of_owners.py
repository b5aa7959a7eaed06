"""Studies belong to their owners as plans do, and so do the plans of their points."""

from __future__ import annotations

from typing import Any

import httpx
import pytest
from access.conftest import GuardedService
from support.service import finished, task

BODY = {"task": task(external_id="now"), "axes": [{"pointer": "/cup/max_force", "values": [15, 20]}]}


def posted(client: httpx.Client, **headers: str) -> dict[str, Any]:
    answer = client.post("/v1/studies", json=BODY, headers={"Prefer": "wait=25", **headers})
    assert answer.status_code == 200, answer.text
    return answer.json()


@pytest.mark.slow
def test_the_study_of_somebody_else_does_not_exist(service: GuardedService) -> None:
    with service.client("writer") as writer, service.client("stranger") as stranger, service.client("admin") as admin:
        study = posted(writer)
        links = study["links"]
        for method, path in (
            ("GET", links["self"]),
            ("GET", links["map"]),
            ("GET", links["picture"]),
            ("GET", links["events"]),
            ("GET", links["view"]),
            ("POST", links["cancel"]),
            ("POST", f"{links['points']}/0/plan"),
            ("DELETE", links["self"]),
        ):
            assert stranger.request(method, path).status_code == 404, (method, path)
        assert stranger.get("/v1/studies").json()["studies"] == []
        assert study["id"] in [each["id"] for each in admin.get("/v1/studies").json()["studies"]]


def test_a_reader_may_look_at_a_study_but_not_touch_it(service: GuardedService) -> None:
    with service.client("writer") as writer, service.client("reader") as reader:
        study = posted(writer)
        assert reader.get(study["links"]["map"]).json()["done"] == 2
        assert reader.post("/v1/studies", json=BODY).status_code == 403
        assert reader.post(f"{study['links']['points']}/0/plan").status_code == 403
        assert reader.delete(study["links"]["self"]).status_code == 403


def test_the_plan_of_a_point_belongs_to_whom_the_study_belongs(service: GuardedService) -> None:
    with service.client("writer") as writer, service.client("stranger") as stranger, service.client("admin") as admin:
        study = posted(writer)
        plan = admin.post(f"{study['links']['points']}/0/plan").json()
        assert finished(writer, plan)["outcome"] == "solved"
        assert stranger.get(plan["links"]["self"]).status_code == 404
        assert writer.get(study["best_plan"]).status_code == 200


def test_two_owners_may_choose_the_same_key_for_a_study(service: GuardedService) -> None:
    with service.client("writer") as writer, service.client("stranger") as stranger:
        key = {"Idempotency-Key": "study-1"}
        first, again, other = posted(writer, **key), posted(writer, **key), posted(stranger, **key)
        assert first["id"] == again["id"] != other["id"]


def test_who_posted_a_study_is_in_the_audit_log(service: GuardedService) -> None:
    with service.client("writer") as writer, service.client("admin") as admin:
        study = posted(writer)
        writer.delete(study["links"]["self"])
        entries = admin.get("/v1/audit").json()["entries"]
        told = [
            (entry["action"], entry["owner"], entry["status"]) for entry in entries if study["id"] in entry["target"]
        ]
        assert ("POST", "mes", 200) in told
        assert ("DELETE", "mes", 204) in told
