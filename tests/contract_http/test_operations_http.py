"""What operators read: metrics, and ids that lead from an answer to the log."""

from __future__ import annotations

import re

import httpx

from tests.support.service import finished, task


def value(text: str, sample: str) -> float:
    """Return the value of one sample of the metrics, 0 if it is not there yet."""
    found = re.search(rf"^{re.escape(sample)} (\S+)$", text, re.MULTILINE)
    return 0.0 if found is None else float(found[1])


def test_a_job_shows_in_the_metrics_of_documents_and_requests(client: httpx.Client) -> None:
    made = 'liftwright_documents_made_total{outcome="solved"}'
    asked = 'liftwright_request_seconds_count{method="POST",route="/v1/plans",status="202"}'
    before = client.get("/metrics").text
    finished(client, client.post("/v1/plans", json=task(external_id="now")).json())
    after = client.get("/metrics").text
    assert value(after, made) == value(before, made) + 1
    assert value(after, asked) == value(before, asked) + 1
    assert value(after, 'liftwright_jobs{state="running"}') == 0


def test_methods_that_somebody_makes_up_are_counted_as_one(client: httpx.Client) -> None:
    other = 'liftwright_request_seconds_count{method="other",route="/livez",status="405"}'
    before = client.get("/metrics").text
    for method in ("BREW", "WHEN", "GET2"):
        assert client.request(method, "/livez").status_code == 405
    after = client.get("/metrics").text
    assert value(after, other) == value(before, other) + 3
    assert not re.search('method="(BREW|WHEN|GET2)"', after)


def test_deaths_of_solvers_and_failures_are_counted_by_why(client: httpx.Client) -> None:
    before = client.get("/metrics").text
    finished(client, client.post("/v1/plans", json=task(external_id="die")).json())
    finished(client, client.post("/v1/plans", json=task(external_id="fail")).json())
    after = client.get("/metrics").text
    for sample, more in (
        ("liftwright_solver_deaths_total", 3),
        ('liftwright_failed_jobs_total{why="crashes"}', 1),
        ('liftwright_failed_jobs_total{why="fault"}', 1),
    ):
        assert value(after, sample) == value(before, sample) + more, sample


def test_an_answer_bears_the_id_that_was_sent_or_one_of_its_own(client: httpx.Client) -> None:
    assert client.get("/livez", headers={"X-Request-ID": "order-7.a"}).headers["X-Request-ID"] == "order-7.a"
    for given in ("", "a b", "x" * 65, "a\tb"):
        answered = client.get("/v1/plans/none", headers={"X-Request-ID": given})
        assert answered.status_code == 404
        assert re.fullmatch(r"[0-9a-f]{32}", answered.headers["X-Request-ID"])
