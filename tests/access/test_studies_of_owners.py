"""Studies belong to their owners as plans do, and so do the plans of their points."""

from __future__ import annotations

import json
from typing import Any

import httpx
import pytest
from websockets.sync.client import connect

from tests.access.conftest import GuardedService
from tests.support.service import finished, task

BODY = {"task": task(external_id="now"), "axes": [{"pointer": "/cup/max_force", "values": [15, 20]}]}


def posted(client: httpx.Client, **headers: str) -> dict[str, Any]:
    """Return a study that is accepted, and waited for however long it takes."""
    answer = client.post("/v1/studies", json=BODY, headers=headers)
    assert answer.status_code == 202, answer.text
    return finished(client, answer.json())


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


def refusal_to_paint(service: GuardedService, name: str, study: str) -> str:
    """Return why a study's map is not painted into an empty scene of the viewer."""
    headers = {"Authorization": f"Bearer {service.keys[name]}"}
    with connect(f"{service.address.replace('http', 'ws')}/viewer/watch", additional_headers=headers) as socket:
        assert json.loads(socket.recv(timeout=60))["type"] == "scene"
        socket.send(json.dumps({"type": "paint", "study": study}))
        told = json.loads(socket.recv(timeout=60))
    assert (told["type"], told["study"]) == ("refused", study)
    return told["detail"]


def test_the_viewer_paints_the_study_of_nobody_else(service: GuardedService) -> None:
    with service.client("writer") as writer, service.client("stranger") as stranger:
        study = writer.post("/v1/studies", json=BODY).raise_for_status().json()
        hidden = stranger.get(study["links"]["self"])
        assert hidden.status_code == 404
        assert refusal_to_paint(service, "stranger", study["id"]) == hidden.json()["detail"]
        # To whom it belongs, and who may see all, it is refused for what it is: no map of cup places.
        for name in ("writer", "reader", "admin"):
            assert "place of a lifter's cup" in refusal_to_paint(service, name, study["id"])


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


@pytest.mark.slow
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
        assert ("POST", "mes", 202) in told
        assert ("DELETE", "mes", 204) in told
