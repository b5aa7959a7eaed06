"""GET /v1/plans with a query: every plan that fits is found once, nothing else is, and a wrong query is explained."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from typing import Any

import httpx
import pytest

from app.resources.queries import PlanQuery
from planners.contract.task_spec import KINDS
from tests.support.places import on_one_or_both_databases
from tests.support.service import finished, task, wait_for
from workers.stores.jobs import JobState

TOOL_TASK = "domino_pile.json"
PARAMETERS = sorted(PlanQuery.model_fields)


@pytest.fixture(scope="module")
def plans(address: str) -> list[dict[str, Any]]:
    """One plan of each state and kind, oldest first; `order-7` twice."""
    with httpx.Client(base_url=address, timeout=30.0) as client:
        posted = [
            client.post("/v1/plans", json=body).json()
            for body in (
                task(external_id="order-7"), task(external_id="fail"), task(external_id="order-7", seed=1),
                task(TOOL_TASK, external_id="order-8"), task(external_id="simulate-slip"),
                task(external_id="simulate-1"),
            )
        ]  # fmt: skip
        ended = [finished(client, plan) for plan in posted]
        held = client.post("/v1/plans", json=task(external_id="hang")).json()
        waiting = client.post("/v1/plans", json=task(external_id="cancelled")).json()
        client.post(waiting["links"]["cancel"])
        return [*ended, held, finished(client, waiting)]


def found(client: httpx.Client, **query: Any) -> list[dict[str, Any]]:
    """Walk through all pages of a query, two plans at a time."""
    listed, token = [], {}
    while True:
        page = client.get("/v1/plans", params={**query, "page_size": 2, **token}).raise_for_status().json()
        listed += page["plans"]
        if page["next_page_token"] is None:
            return listed
        assert len(page["plans"]) == 2
        token = {"page_token": page["next_page_token"]}


@on_one_or_both_databases
@pytest.mark.parametrize(
    "query",
    [
        {"external_id": "order-7"},
        {"external_id": "order"},
        {"kind": "suction_tool"},
        {"state": "succeeded"},
        {"state": "failed"},
        {"state": "cancelled"},
        {"outcome": "solved"},
        {"outcome": "infeasible"},
        {"physics": "failed"},
        {"physics": "passed"},
        {"physics": "failed", "state": "failed"},
        {"kind": "plate_lift", "state": "succeeded", "outcome": "solved", "external_id": "order-7"},
        {"state": "failed", "outcome": "solved"},
        {"state": "running", "outcome": "solved"},
    ],
)
def test_a_query_finds_what_a_look_at_all_plans_finds(
    client: httpx.Client, plans: list[dict[str, Any]], query: dict[str, str]
) -> None:
    everything = found(client)
    assert {plan["id"] for plan in plans} <= {plan["id"] for plan in everything}
    fitting = [plan["id"] for plan in everything if all(plan[name] == wish for name, wish in query.items())]
    assert [plan["id"] for plan in found(client, **query)] == fitting


def test_names_are_found_in_capitals_or_not_whatever_their_letters_are(client: httpx.Client) -> None:
    """As PostgreSQL does, if the locale of its database knows them."""
    plan = client.post("/v1/plans", json=task(external_id="Größe-7")).raise_for_status().json()
    for name in ("größe", "RÖ", "Ö", "ö"):
        assert [each["id"] for each in found(client, name=name)] == [plan["id"]], name


@on_one_or_both_databases
@pytest.mark.parametrize("name", ["order", "ORDER-7", "r-8", "%", "_", "no such name"])
def test_a_part_of_a_name_finds_what_a_look_at_all_plans_finds(
    client: httpx.Client, plans: list[dict[str, Any]], name: str
) -> None:
    everything = found(client)
    told = {plan["id"]: f"{plan['external_id']}\n{plan['work_master']}".lower() for plan in everything}
    fitting = [plan["id"] for plan in everything if name.lower() in told[plan["id"]]]
    assert [plan["id"] for plan in found(client, name=name)] == fitting
    assert {plan["id"] for plan in plans} <= set(told)


@on_one_or_both_databases
def test_the_beginning_of_an_id_finds_its_plan(client: httpx.Client, plans: list[dict[str, Any]]) -> None:
    assert [plan["id"] for plan in found(client, name=plans[0]["id"][:12].upper())] == [plans[0]["id"]]


@on_one_or_both_databases
def test_times_divide_all_plans_into_those_before_and_those_from_then_on(
    client: httpx.Client, plans: list[dict[str, Any]]
) -> None:
    moment = plans[2]["created_at"]
    before, since = found(client, created_until=moment), found(client, created_from=moment)
    assert [plan["id"] for plan in since + before] == [plan["id"] for plan in found(client)]
    assert plans[2]["id"] in {plan["id"] for plan in since}
    assert plans[1]["id"] in {plan["id"] for plan in before}


@on_one_or_both_databases
def test_who_waits_is_told_a_place_and_the_next_one_comes_after(
    client: httpx.Client, plans: list[dict[str, Any]]
) -> None:
    slots = client.get("/v1/capabilities").json()["limits"]["worker_slots"]
    in_the_way = [client.post("/v1/plans", json=task(external_id="hang")).json() for _ in range(slots)]
    for plan in in_the_way:
        wait_for(lambda plan=plan: client.get(plan["links"]["self"]).json()["state"] == "running")
    late, early = (
        client.post("/v1/plans", json=task(external_id="waits"), params={"priority": priority}).json()
        for priority in (0, 5)
    )
    waiting = [client.get(plan["links"]["self"]).json() for plan in (early, late)]
    places = [plan["queue_position"] for plan in waiting]
    assert places == [places[0], places[0] + 1]
    assert plans[0]["queue_position"] is None
    # No job that ended took longer than from its post to its end, and each slot does the next one when it is free.
    ended = [each for each in found(client) if each["done"]]
    longest = max(_moment(each["finished_at"]) - _moment(each["created_at"]) for each in ended)
    now = datetime.now(UTC)
    early_at, late_at = (_moment(plan["expected_start"]) for plan in waiting)
    assert early_at < late_at <= now + places[1] * longest / slots + timedelta(seconds=1.0)
    assert early_at > now - timedelta(seconds=5.0)
    assert plans[0]["expected_start"] is None
    for plan in (late, early, *in_the_way):
        client.post(plan["links"]["cancel"])
    cancelled = client.get(late["links"]["self"]).json()
    assert cancelled["queue_position"] is cancelled["expected_start"] is None


def _moment(told: str) -> datetime:
    return datetime.fromisoformat(told)


def test_every_kind_and_state_of_a_plan_can_be_asked_for() -> None:
    properties = PlanQuery.model_json_schema()["properties"]
    assert properties["kind"]["anyOf"][0]["enum"] == list(KINDS)
    assert properties["state"]["anyOf"][0]["enum"] == [state.value for state in JobState]


@pytest.mark.parametrize(
    ("query", "pointer", "allowed"),
    [
        ({"state": "done"}, "/query/state", ["queued", "running", "succeeded", "failed", "cancelled"]),
        ({"outcome": "perfect"}, "/query/outcome", ["solved", "infeasible", "not_found"]),
        ({"kind": "regrasp"}, "/query/kind", list(KINDS)),
        ({"externalId": "order-7"}, "/query/externalId", PARAMETERS),
    ],
)
def test_a_query_that_cannot_be_followed_is_answered_with_the_choices(
    client: httpx.Client, query: dict[str, str], pointer: str, allowed: list[str]
) -> None:
    answer = client.get("/v1/plans", params=query)
    assert (answer.status_code, answer.headers["Content-Type"]) == (422, "application/problem+json")
    (problem,) = answer.json()["errors"]
    assert problem["pointer"] == pointer
    assert sorted(problem["allowed"]) == sorted(allowed)


def test_a_name_that_no_task_can_have_is_refused(client: httpx.Client) -> None:
    assert client.get("/v1/plans", params={"external_id": "a\0b"}).status_code == 422


def test_head_and_get_agree_on_a_wrong_query(client: httpx.Client) -> None:
    assert client.head("/v1/plans", params={"order": "newest"}).status_code == 422
