"""Messages to webhooks, over the wire to a receiver of the test."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

import httpx
import pytest
from standardwebhooks.webhooks import Webhook

from app.access.caller import Scope
from app.cli.keys_command import issue_key
from app.settings import ServiceSettings
from tests.support.receiver import Receiver, running_receiver
from tests.support.service import FAKE_SOLVER, task, wait_for
from tests.support.serving import served


@pytest.fixture(scope="module")
def receiver() -> Iterator[Receiver]:
    with running_receiver() as receiver:
        yield receiver


@pytest.fixture(scope="module")
def clients(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, httpx.Client]]:
    settings = ServiceSettings.model_validate(
        {
            "data_dir": tmp_path_factory.mktemp("data"),
            "solver_command": FAKE_SOLVER,
            "worker_slots": 1,
            "webhook_networks": ["127.0.0.0/8"],
            "webhook_retry_seconds": [0.2, 0.2, 0.2],
        }
    )
    keys = {owner: issue_key(settings, owner, Scope.WRITE, None) for owner in ("mes", "other", "many")}
    with served(settings) as address:
        made = {
            owner: httpx.Client(base_url=address, headers={"Authorization": f"Bearer {key}"}, timeout=30)
            for owner, key in keys.items()
        }
        yield made
        for client in made.values():
            client.close()


def register(client: httpx.Client, url: str, plans: str = "named") -> dict[str, Any]:
    answer = client.post("/v1/webhooks", json={"url": url, "plans": plans})
    assert answer.status_code == 201, answer.text
    assert answer.headers["Location"] == answer.json()["links"]["self"]
    return answer.json()


def plan_for(client: httpx.Client, webhook: dict[str, Any], wish: str = "now") -> dict[str, Any]:
    return client.post("/v1/plans", params={"webhook": webhook["id"]}, json=task(external_id=wish)).json()


def settled(client: httpx.Client, webhook: dict[str, Any]) -> dict[str, Any]:
    """Return the newest message once it will never change again."""

    def newest() -> dict[str, Any]:
        return client.get(webhook["links"]["deliveries"]).json()["deliveries"][0]

    wait_for(lambda: newest()["state"] in ("delivered", "failed"))
    return newest()


def test_the_end_of_a_job_is_told_signed_and_thin(clients: dict[str, httpx.Client], receiver: Receiver) -> None:
    client = clients["mes"]
    webhook = register(client, f"{receiver.address}/hook")
    plan = plan_for(client, webhook)
    delivery = settled(client, webhook)
    assert (delivery["state"], delivery["plan_id"]) == ("delivered", plan["id"])
    assert [(tried["number"], tried["status"], tried["failure"]) for tried in delivery["attempts"]] == [(1, 204, None)]
    ((headers, body),) = receiver.at("/hook")
    assert headers["webhook-id"] == delivery["id"]
    message = Webhook(webhook["secret"]).verify(body, headers)
    assert message["type"] == "plan.succeeded"
    links = {"self": plan["links"]["self"]}
    told = {"id": plan["id"], "external_id": "now", "state": "succeeded", "outcome": "solved", "physics": None}
    assert message["data"] == {**told, "links": links}


@pytest.mark.slow
@pytest.mark.parametrize(("name", "physics"), [("simulate-1", "passed"), ("simulate-slip", "failed")])
def test_how_a_plan_fared_in_physics_is_told_at_its_end(
    clients: dict[str, httpx.Client], receiver: Receiver, name: str, physics: str
) -> None:
    client = clients["mes"]
    webhook = register(client, f"{receiver.address}/{name}")
    plan = plan_for(client, webhook, name)
    settled(client, webhook)
    ((_, body),) = receiver.at(f"/{name}")
    assert json.loads(body)["data"]["physics"] == physics
    assert client.get(plan["links"]["self"]).json()["physics"] == physics


@pytest.mark.slow
def test_failed_and_cancelled_jobs_are_told_too(clients: dict[str, httpx.Client], receiver: Receiver) -> None:
    client = clients["mes"]
    webhook = register(client, f"{receiver.address}/ends")
    plan_for(client, webhook, "fail")
    settled(client, webhook)
    client.post(plan_for(client, webhook, "hang")["links"]["cancel"])
    settled(client, webhook)
    told = [json.loads(body)["type"] for _, body in receiver.at("/ends")]
    assert told == ["plan.failed", "plan.cancelled"]


@pytest.mark.slow
def test_a_receiver_that_is_away_is_tried_again_with_the_same_id_and_body(
    clients: dict[str, httpx.Client], receiver: Receiver
) -> None:
    client = clients["mes"]
    webhook = register(client, f"{receiver.address}/later")
    plan_for(client, webhook)
    delivery = settled(client, webhook)
    assert [tried["status"] for tried in delivery["attempts"]] == [503, 503, 204]
    got = receiver.at("/later")
    assert len({headers["webhook-id"] for headers, _ in got}) == len({body for _, body in got}) == 1


@pytest.mark.slow
def test_a_receiver_that_never_takes_it_is_given_up(clients: dict[str, httpx.Client], receiver: Receiver) -> None:
    client = clients["mes"]
    webhook = register(client, f"{receiver.address}/never")
    plan_for(client, webhook)
    delivery = settled(client, webhook)
    assert (delivery["state"], [tried["status"] for tried in delivery["attempts"]]) == ("failed", [500] * 4)


@pytest.mark.slow
def test_redirects_are_not_followed(clients: dict[str, httpx.Client], receiver: Receiver) -> None:
    client = clients["mes"]
    webhook = register(client, f"{receiver.address}/elsewhere")
    plan_for(client, webhook)
    assert "redirect" in settled(client, webhook)["attempts"][0]["failure"]
    assert receiver.at("/trap") == []


def test_a_receiver_that_is_gone_for_good_is_told_nothing_more(
    clients: dict[str, httpx.Client], receiver: Receiver
) -> None:
    client = clients["mes"]
    webhook = register(client, f"{receiver.address}/gone")
    plan_for(client, webhook)
    assert len(settled(client, webhook)["attempts"]) == 1
    assert client.get(webhook["links"]["self"]).json()["disabled_at"] is not None
    answer = client.post("/v1/plans", params={"webhook": webhook["id"]}, json=task(external_id="now"))
    assert answer.status_code == 422
    assert answer.json()["errors"][0]["pointer"] == "/query/webhook"


def test_a_rotated_secret_and_the_one_before_both_verify(clients: dict[str, httpx.Client], receiver: Receiver) -> None:
    client = clients["mes"]
    webhook = register(client, f"{receiver.address}/rotated")
    rotated = client.post(webhook["links"]["rotate"]).json()
    assert rotated["secret"] != webhook["secret"]
    plan_for(client, webhook)
    settled(client, webhook)
    ((headers, body),) = receiver.at("/rotated")
    for secret in (webhook["secret"], rotated["secret"]):
        Webhook(secret).verify(body, headers)


def test_secrets_are_told_once_and_webhooks_belong_to_their_owner(clients: dict[str, httpx.Client]) -> None:
    webhook = register(clients["mes"], "https://mes.example/hook")
    assert clients["mes"].get(webhook["links"]["self"]).json() == {**webhook, "secret": None}
    for method, path in (("GET", "self"), ("DELETE", "self"), ("GET", "deliveries"), ("POST", "rotate")):
        assert clients["other"].request(method, webhook["links"][path]).status_code == 404
    assert clients["other"].get("/v1/webhooks").json()["webhooks"] == []
    answer = clients["other"].post("/v1/plans", params={"webhook": webhook["id"]}, json=task(external_id="now"))
    assert answer.status_code == 422
    assert clients["mes"].delete(webhook["links"]["self"]).status_code == 204
    assert clients["mes"].get(webhook["links"]["self"]).status_code == 404


@pytest.mark.slow
def test_a_webhook_for_all_plans_hears_of_its_owners_and_nobody_elses(
    clients: dict[str, httpx.Client], receiver: Receiver
) -> None:
    webhook = register(clients["other"], f"{receiver.address}/all", "all")
    clients["mes"].post("/v1/plans", json=task(external_id="now"), headers={"Prefer": "wait=20"})
    mine = clients["other"].post("/v1/plans", json=task(external_id="now")).json()
    settled(clients["other"], webhook)
    assert [json.loads(body)["data"]["id"] for _, body in receiver.at("/all")] == [mine["id"]]


def test_an_owner_has_so_many_webhooks_and_no_more_until_one_is_deleted(clients: dict[str, httpx.Client]) -> None:
    client, body = clients["many"], {"url": "https://mes.example/hook", "plans": "named"}
    most = client.get("/v1/capabilities").json()["limits"]["max_webhooks"]
    webhooks = [register(client, body["url"]) for _ in range(most)]
    refused = client.post("/v1/webhooks", json=body)
    assert (refused.status_code, refused.json()["title"]) == (409, "Too many webhooks")
    register(clients["mes"], body["url"])
    assert client.delete(webhooks[0]["links"]["self"]).status_code == 204
    register(client, body["url"])


@pytest.mark.parametrize(
    "body", [{}, {"url": 1}, {"url": "http://8.8.8.8/"}, {"url": "https://10.0.0.1/"}, {"url": "https://a/", "x": 1}]
)
def test_what_is_no_webhook_is_refused(clients: dict[str, httpx.Client], body: dict[str, Any]) -> None:
    answer = clients["mes"].post("/v1/webhooks", json=body)
    assert answer.status_code == 422
    assert answer.json()["errors"]
