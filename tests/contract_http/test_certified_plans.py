"""A plan that is certified can be fetched, and is told of, while it is still simulated."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from typing import Any

import httpx
import pytest

from app.settings import ServiceSettings
from tests.support.places import on_one_or_both_databases
from tests.support.receiver import Receiver, running_receiver
from tests.support.service import FAKE_SOLVER, finished, task, wait_for
from tests.support.serving import served

pytestmark = on_one_or_both_databases


@pytest.fixture(scope="module")
def receiver() -> Iterator[Receiver]:
    with running_receiver() as receiver:
        yield receiver


@pytest.fixture(scope="module")
def client(tmp_path_factory: pytest.TempPathFactory, place: dict[str, str]) -> Iterator[httpx.Client]:
    settings = ServiceSettings.model_validate(
        {
            "data_dir": tmp_path_factory.mktemp("data"),
            "solver_command": FAKE_SOLVER,
            "worker_slots": 1,
            # On a machine that is very busy, too, each job is done at the first attempt.
            "patience_seconds": 30.0,
            "frozen_seconds": 60.0,
            "webhook_networks": ["127.0.0.0/8"],
            **place,
        }
    )
    with served(settings) as address, httpx.Client(base_url=address, timeout=30.0) as client:
        yield client


def post(client: httpx.Client, wish: str, **query: str) -> dict[str, Any]:
    return client.post("/v1/plans", params=query, json=task(external_id=wish)).raise_for_status().json()


def certified(client: httpx.Client, plan: dict[str, Any]) -> dict[str, Any]:
    """Wait until a plan is certified, and return it."""
    last: dict[str, Any] = {}

    def known() -> bool:
        last.update(client.get(plan["links"]["self"]).json())
        return last["certified_at"] is not None

    wait_for(known)
    return last


@pytest.mark.slow
def test_the_document_can_be_fetched_while_the_plan_is_simulated_and_changes_its_tag_when_that_is_done(
    client: httpx.Client,
) -> None:
    plan = certified(client, post(client, "simulate-20"))
    assert (plan["state"], plan["done"], plan["outcome"], plan["physics"]) == ("running", False, None, None)
    address = plan["links"]["document"]
    before = client.get(address)
    assert before.status_code == 200
    assert before.headers["Cache-Control"] == "no-cache"
    assert (before.json()["outcome"], before.json()["simulation"]) == ("solved", None)
    known = {"If-None-Match": before.headers["ETag"]}
    assert client.get(address, headers=known).status_code == 304
    ended = finished(client, plan)
    assert (ended["state"], ended["outcome"], ended["attempts"]) == ("succeeded", "solved", 1)
    assert (ended["physics"], ended["certified_at"]) == ("passed", plan["certified_at"])
    after = client.get(address, headers=known)
    assert after.status_code == 200
    assert after.headers["ETag"] != before.headers["ETag"]
    assert after.json() == {**before.json(), "simulation": {"outcome": "lifted"}}


def test_plans_that_are_not_simulated_are_certified_when_they_end_and_without_a_plan_there_is_nothing_to_certify(
    client: httpx.Client,
) -> None:
    solved, infeasible = (finished(client, post(client, wish)) for wish in ("now", "infeasible"))
    assert solved["certified_at"] is not None
    assert (infeasible["certified_at"], infeasible["state"]) == (None, "succeeded")


@pytest.mark.slow
def test_a_proof_that_there_is_no_plan_can_be_fetched_while_changes_are_tried_that_would_help(
    client: httpx.Client,
) -> None:
    plan = post(client, "remedies-20")
    address = plan["links"]["document"]

    def known() -> dict[str, Any]:
        now = client.get(plan["links"]["self"]).json()
        return now if now["verdict"] else {}

    now = wait_for(known)
    assert (now["state"], now["verdict"], now["outcome"], now["certified_at"]) == ("running", "infeasible", None, None)
    before = client.get(address).raise_for_status()
    ended = finished(client, plan)
    assert (ended["state"], ended["verdict"], ended["outcome"]) == ("succeeded", "infeasible", "infeasible")
    after = client.get(address, headers={"If-None-Match": before.headers["ETag"]})
    assert after.json() == {**before.json(), "remedies": ["another place"]}
    told = [name for name in re.findall("^event: (.*)$", client.get(plan["links"]["events"]).text, re.MULTILINE)]
    assert [name for name in told if name != "progress"] == ["verdict", "finished"]


@pytest.mark.slow
def test_whoever_waits_for_a_verdict_does_not_wait_for_the_physics_and_remedies_of_others(client: httpx.Client) -> None:
    """The one that is begun while the other two wait is put off, and done when nobody waits any more."""
    ahead = post(client, "steps-20")
    wait_for(lambda: client.get(ahead["links"]["self"]).json()["state"] == "running")
    first, second = post(client, "remedies-40"), post(client, "simulate-40")

    def both_known() -> list[dict[str, Any]]:
        now = [client.get(plan["links"]["self"]).json() for plan in (first, second)]
        return now if all(plan["verdict"] for plan in now) else []

    put_off, last = wait_for(both_known)
    assert (put_off["state"], put_off["verdict"], put_off["queue_position"]) == ("running", "infeasible", None)
    assert (last["state"], last["verdict"]) == ("running", "solved")
    found = client.get("/v1/plans", params={"state": "running"}).json()["plans"]
    assert {first["id"], second["id"]} <= {plan["id"] for plan in found}
    put_off, last = finished(client, first), finished(client, second)
    assert (put_off["state"], put_off["attempts"], last["state"], last["attempts"]) == ("succeeded", 2, "succeeded", 1)
    assert put_off["finished_at"] > last["finished_at"]
    assert client.get(put_off["links"]["document"]).json()["remedies"]


def test_an_event_of_its_own_tells_that_a_plan_is_certified_between_those_of_progress(client: httpx.Client) -> None:
    plan = finished(client, post(client, "simulate-4"))
    seen: list[tuple[str, dict[str, Any]]] = []
    fields: dict[str, str] = {}
    for line in client.get(plan["links"]["events"]).text.splitlines():
        name, _, value = line.partition(": ")
        fields[name] = value
        if name == "data":
            seen.append((fields["event"], json.loads(value)))
    kinds = [kind for kind, _ in seen]
    assert kinds.count("certified") == 1
    assert set(kinds) == {"progress", "certified", "finished"}
    told = dict(seen)["certified"]
    # Who knows progress alone finds all of it in this one, too.
    progress = dict(seen)["progress"]
    assert told == {
        **progress,
        "stage": "certify",
        "done": 1,
        "total": 1,
        "fraction": told["fraction"],
        "outcome": "solved",
    }
    fractions = [data["fraction"] for kind, data in seen if kind != "finished"]
    assert fractions == sorted(fractions)
    assert {data["stage"] for _, data in seen[kinds.index("certified") + 1 : -1]} == {"simulate"}


@pytest.mark.parametrize(("wish", "state"), [("simulate-fail", "failed"), ("simulate-hang", "cancelled")])
def test_a_certified_document_stays_whatever_becomes_of_the_simulation(
    client: httpx.Client, wish: str, state: str
) -> None:
    plan = certified(client, post(client, wish))
    if state == "cancelled":
        client.post(plan["links"]["cancel"])
    assert finished(client, plan)["state"] == state
    document = client.get(plan["links"]["document"])
    assert document.json()["simulation"] is None
    assert client.delete(plan["links"]["self"]).status_code == 204
    assert client.get(plan["links"]["document"]).status_code == 404


@pytest.mark.slow
def test_a_solver_that_dies_in_the_simulation_is_followed_by_one_that_simulates_the_same_plan(
    client: httpx.Client,
) -> None:
    plan = finished(client, post(client, "simulate-die"))
    assert (plan["state"], plan["attempts"]) == ("succeeded", 2)
    seen = client.get(plan["links"]["events"]).text
    assert seen.count("event: certified") == 1
    told = [json.loads(line.removeprefix("data: ")) for line in seen.splitlines() if line.startswith("data: ")]
    again = {each["stage"] for each in told if each.get("attempt") == 2 and "stage" in each}
    # The second solver may have to be loaded first; it plans nothing.
    assert again - {"load"} == {"simulate"}
    assert client.get(plan["links"]["document"]).json()["simulation"] == {"outcome": "lifted"}


@pytest.mark.parametrize("wants", [True, False])
def test_webhooks_are_told_of_certified_plans_if_they_want_to_know_and_of_the_end_as_ever(
    client: httpx.Client, receiver: Receiver, wants: bool
) -> None:
    path = f"/{client.base_url.port}/{wants}"
    spec = {"url": receiver.address + path, "plans": "named", **({"certified": True} if wants else {})}
    webhook = client.post("/v1/webhooks", json=spec).raise_for_status().json()
    assert webhook["certified"] is wants
    plan = certified(client, post(client, "simulate-hang", webhook=webhook["id"]))
    wait_for(lambda: len(receiver.at(path)) == wants)
    client.post(plan["links"]["cancel"])
    wait_for(lambda: len(receiver.at(path)) == 1 + wants)
    messages = [json.loads(body) for _, body in receiver.at(path)]
    assert [each["type"] for each in messages] == [*(["plan.certified"] if wants else []), "plan.cancelled"]
    told = [(each["data"]["id"], each["data"]["state"], each["data"]["outcome"]) for each in messages]
    assert told == [*([(plan["id"], "running", "solved")] if wants else []), (plan["id"], "cancelled", None)]
    sent = client.get(webhook["links"]["deliveries"]).json()["deliveries"]
    assert {each["type"] for each in sent} == {each["type"] for each in messages}
