"""A job's events over the wire."""

from __future__ import annotations

import json
from typing import Any

import httpx
import pytest

from tests.support.service import task


def follow(client: httpx.Client, plan: dict[str, Any], last_event_id: int | None = None) -> list[tuple[int, str, Any]]:
    headers = {} if last_event_id is None else {"Last-Event-ID": str(last_event_id)}
    events: list[tuple[int, str, Any]] = []
    fields: dict[str, str] = {}
    with client.stream("GET", plan["links"]["events"], headers=headers) as stream:
        assert stream.headers["Content-Type"].startswith("text/event-stream")
        for line in stream.iter_lines():
            name, _, value = line.partition(": ")
            if line:
                fields[name] = value
            elif "data" in fields:
                events.append((int(fields["id"]), fields["event"], json.loads(fields["data"])))
                fields = {}
    return events


def post(client: httpx.Client, wish: str) -> dict[str, Any]:
    return client.post("/v1/plans", json=task(external_id=wish)).json()


def test_events_tell_stages_with_counts_and_a_fraction_that_never_falls_and_end_with_the_plan(
    client: httpx.Client,
) -> None:
    events = follow(client, post(client, "steps-4"))
    assert [kind for _, kind, _ in events] == ["progress"] * (len(events) - 1) + ["finished"]
    assert [number for number, _, _ in events] == list(range(1, len(events) + 1))
    progress = [data for _, _, data in events[:-1]]
    fractions = [data["fraction"] for data in progress]
    assert fractions == sorted(fractions)
    assert {data["attempt"] for data in progress} == {1}
    assert [(data["done"], data["total"]) for data in progress if data["stage"] == "motion"][-1] == (4, 4)
    assert events[-1][2]["state"] == "succeeded"


@pytest.mark.slow
def test_a_stream_resumes_behind_the_last_event_that_was_received(client: httpx.Client) -> None:
    plan = post(client, "steps-4")
    everything = follow(client, plan)
    for last in range(1, len(everything)):
        assert follow(client, plan, last) == everything[last:]


def test_a_client_that_has_everything_is_told_to_stop(client: httpx.Client) -> None:
    plan = post(client, "now")
    last = follow(client, plan)[-1][0]
    answer = client.get(plan["links"]["events"], headers={"Last-Event-ID": str(last)})
    assert answer.status_code == 204


@pytest.mark.parametrize("last", ["x", "-1", "1e3", "", "999999999", "9" * 5000])
@pytest.mark.parametrize("wish", ["now", "hang"])
def test_an_id_that_no_event_of_the_stream_has_is_refused(client: httpx.Client, wish: str, last: str) -> None:
    answer = client.get(post(client, wish)["links"]["events"], headers={"Last-Event-ID": last})
    assert answer.status_code == 400


def test_cancelling_ends_the_stream(client: httpx.Client) -> None:
    plan = post(client, "hang")
    client.post(plan["links"]["cancel"])
    assert follow(client, plan)[-1][2]["state"] == "cancelled"


def test_attempts_are_counted_in_the_events(client: httpx.Client) -> None:
    events = follow(client, post(client, "die"))
    assert {data["attempt"] for _, kind, data in events if kind == "progress"} == {1, 2, 3}
    assert events[-1][2]["state"] == "failed"
