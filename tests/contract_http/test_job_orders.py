"""What an MES says about a job when it posts the task: recipe, priority, and the time in which it has a use for it."""

from __future__ import annotations

import json
from datetime import UTC, datetime, timedelta
from typing import Any

import httpx
import pytest

from tests.support.service import finished, task, wait_for


def post(client: httpx.Client, wish: str, **order: Any) -> dict[str, Any]:
    answer = client.post("/v1/plans", json=task(external_id=wish), params=order)
    assert answer.status_code == 202, answer.text
    return answer.json()


def soon(seconds: float) -> str:
    return (datetime.now(UTC) + timedelta(seconds=seconds)).isoformat()


def moment(text: str) -> datetime:
    return datetime.fromisoformat(text)


def state_of(client: httpx.Client, plan: dict[str, Any]) -> str:
    return client.get(plan["links"]["self"]).json()["state"]


def test_an_order_is_handed_back_and_its_plans_are_found_by_the_recipe(client: httpx.Client) -> None:
    start, end = "2001-02-03T04:05:06.5+01:00", "2999-12-31T23:59:59Z"
    order = {"work_master": "LIFT-300", "priority": 7, "start_time": start, "end_time": end}
    plan = finished(client, post(client, "now", **order))
    assert (plan["work_master"], plan["priority"], plan["outcome"]) == ("LIFT-300", 7, "solved")
    assert (moment(plan["start_time"]), moment(plan["end_time"])) == (moment(start), moment(end))
    found = client.get("/v1/plans", params={"work_master": "LIFT-300"}).json()["plans"]
    assert [each["id"] for each in found] == [plan["id"]]


def test_without_an_order_a_job_is_begun_at_once_and_may_take_as_long_as_it_does(client: httpx.Client) -> None:
    plan = finished(client, post(client, "now"))
    assert (plan["work_master"], plan["priority"], plan["start_time"], plan["end_time"]) == (None, 0, None, None)


@pytest.mark.parametrize(
    ("headers", "body", "status"),
    [
        ({"Prefer": "wait=30", "Content-Type": "application/json"}, json.dumps(task(external_id="now")), 200),
        ({"Idempotency-Key": "", "Content-Type": "application/json"}, json.dumps(task()), 400),
        ({"Content-Type": "text/plain"}, json.dumps(task()), 415),
        ({"Content-Type": "application/json"}, "{", 400),
        ({"Content-Type": "application/json"}, json.dumps(task(cell="none")), 422),
    ],
)
def test_a_task_with_an_order_that_says_nothing_is_answered_as_one_without(
    client: httpx.Client, headers: dict[str, str], body: str, status: int
) -> None:
    plain, ordered = (
        client.post("/v1/plans", content=body, headers=headers, params=order) for order in ({}, {"priority": 0})
    )
    assert plain.status_code == ordered.status_code == status
    assert plain.headers.keys() == ordered.headers.keys()
    assert plain.json().keys() == ordered.json().keys()
    assert status == 200 or plain.json() == ordered.json()


@pytest.mark.slow
def test_a_job_is_not_begun_before_its_time_and_then_without_being_asked(client: httpx.Client) -> None:
    start = soon(2.0)
    plan = post(client, "now", start_time=start)
    assert plan["state"] == "queued"
    plan = finished(client, plan)
    assert plan["outcome"] == "solved"
    assert moment(plan["started_at"]) >= moment(start)


@pytest.mark.parametrize("wish", ["hang", "now"])
@pytest.mark.slow
def test_a_job_that_has_not_ended_by_its_time_is_cancelled_whether_it_runs_or_waits(
    client: httpx.Client, wish: str
) -> None:
    at_work = post(client, "hang") if wish == "now" else None
    if at_work is not None:
        wait_for(lambda: state_of(client, at_work) == "running")
    end = soon(1.5)
    plan = finished(client, post(client, wish, end_time=end))
    assert (plan["state"], plan["outcome"], plan["cancelled_by"], plan["error"]) == (
        "cancelled",
        None,
        "end_time",
        None,
    )
    assert moment(plan["finished_at"]) >= moment(end)
    assert plan["job_order_state"] == "Aborted"


def test_a_job_whose_time_is_over_when_it_is_posted_is_accepted_and_cancelled(client: httpx.Client) -> None:
    assert finished(client, post(client, "hang", end_time=soon(-60)))["cancelled_by"] == "end_time"


@pytest.mark.slow
def test_a_job_that_ends_in_time_stays_as_it_ended(client: httpx.Client) -> None:
    for seconds in (2.0, 6.0, 20.0, 60.0):
        end = soon(seconds)
        plan = finished(client, post(client, "now", end_time=end))
        if plan["state"] == "succeeded":
            break
        # A busy machine needs more time: then it was its end that cancelled the job, and not before.
        assert plan["cancelled_by"] == "end_time"
        assert moment(plan["finished_at"]) >= moment(end)
    assert (plan["state"], plan["cancelled_by"]) == ("succeeded", None)
    # Whoever cancels at that time has been there: it has cancelled another.
    assert finished(client, post(client, "hang", end_time=end))["cancelled_by"] == "end_time"
    wait_for(lambda: datetime.now(UTC) > moment(end) + timedelta(seconds=1), 70)
    assert client.get(plan["links"]["self"]).json() == plan


def test_whoever_cancels_a_job_in_its_time_has_cancelled_it(client: httpx.Client) -> None:
    plan = post(client, "hang", end_time=soon(600))
    client.post(plan["links"]["cancel"])
    assert finished(client, plan)["cancelled_by"] == "request"


def test_the_highest_priority_goes_first_and_of_equal_ones_the_oldest(client: httpx.Client) -> None:
    at_work = post(client, "hang")
    wait_for(lambda: state_of(client, at_work) == "running")
    plans = [post(client, "now", priority=priority) for priority in (0, 9, 3, 9)]
    client.post(at_work["links"]["cancel"])
    begun = [finished(client, plan)["started_at"] for plan in plans]
    assert sorted(range(4), key=lambda k: begun[k]) == [1, 3, 2, 0]


@pytest.mark.parametrize(
    ("order", "pointer"),
    [
        ({"priority": 10}, "/query/priority"),
        ({"start_time": "tomorrow"}, "/query/start_time"),
        ({"start_time": "2030-01-01T00:00:00"}, "/query/start_time"),
        ({"start_time": "0.5"}, "/query/start_time"),
        ({"start_time": "2030-02-30T00:00:00Z"}, "/query/start_time"),
        ({"start_time": "0001-01-01T00:00:00+14:00"}, "/query/start_time"),
        ({"end_time": "9999-12-31T23:59:59-14:00"}, "/query/end_time"),
        ({"start_time": "2030-01-02T00:00:00Z", "end_time": "2030-01-01T00:00:00Z"}, "/query/end_time"),
        ({"work_master": "a\nb"}, "/query/work_master"),
        ({"start": "2030-01-01T00:00:00Z"}, "/query/start"),
    ],
)
def test_an_order_that_cannot_be_followed_is_refused(client: httpx.Client, order: dict, pointer: str) -> None:
    answer = client.post("/v1/plans", json=task(), params=order)
    assert (answer.status_code, answer.headers["Content-Type"]) == (422, "application/problem+json")
    assert [problem["pointer"] for problem in answer.json()["errors"]] == [pointer]
