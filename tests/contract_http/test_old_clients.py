"""What a manufacturing execution system was programmed to do with the first version still works.

The requests are written down as they go over the wire, and of the answers only what that version promised is looked at.
Never change a test here: add the next version's.
"""

from __future__ import annotations

import json
import subprocess
import sys
import time
import urllib.error
import urllib.request
from email.message import Message
from pathlib import Path
from typing import Any

import pytest

from tests.support.service import ROOT

ORDER = {
    "kind": "plate_lift",
    "plate": {"shape": {"type": "box", "size": [0.3, 0.3, 0.04]}, "mass": 4.0},
    "plate_pose": [0.3, 0, 1.114, 1, 0, 0, 0],
    "cup": {"position": [0.1, 0], "radius": 0.0175, "max_force": 20},
}
CLIENT = """
import sys, time
from client import Client
from client.api.plans import delete_plan, get_plan, list_plans, post_plan
from client.models import PlateLiftTask

client = Client(base_url=sys.argv[1])
with open(sys.argv[2]) as file:
    task = PlateLiftTask.from_dict(__import__("json").load(file))
plan = post_plan.sync(client=client, body=task, prefer="wait=60")
assert plan.done and plan.state == "succeeded" and plan.outcome == "solved", plan
assert get_plan.sync(plan.id, client=client).finished_at is not None
assert plan.id in [listed.id for listed in list_plans.sync(client=client).plans]
assert delete_plan.sync_detailed(plan.id, client=client).status_code == 204
"""


def call(address: str, method: str, path: str, body: Any = None, **headers: str) -> tuple[int, Any, Message]:
    """Send a request with the standard library alone, as a gateway from 2010 would."""
    data = None if body is None else json.dumps(body).encode()
    typed = {} if body is None else {"Content-Type": "application/json"}
    request = urllib.request.Request(address + path, data, {**typed, **headers}, method=method)
    try:
        with urllib.request.urlopen(request, timeout=30) as answer:
            text = answer.read()
            return answer.status, json.loads(text) if text else None, answer.headers
    except urllib.error.HTTPError as error:
        with error:
            return error.code, json.load(error), error.headers


def test_an_order_is_posted_polled_fetched_and_removed(address: str) -> None:
    status, plan, headers = call(address, "POST", "/v1/plans", {**ORDER, "external_id": "JO-4711"})
    assert (status, plan["external_id"], headers["Location"]) == (202, "JO-4711", plan["links"]["self"])
    while not plan["done"]:
        time.sleep(0.05)
        status, plan, headers = call(address, "GET", f"/v1/plans/{plan['id']}")
        assert (status, headers["Content-Type"]) == (200, "application/json")
        assert plan["state"] in ("queued", "running", "succeeded")
        assert 0 <= plan["progress"]["fraction"] <= 1
    assert (plan["state"], plan["outcome"], plan["error"]) == ("succeeded", "solved", None)
    status, document, _ = call(address, "GET", plan["links"]["document"])
    assert (status, document["id"], document["schema_version"]) == (200, plan["id"], "1.0")
    assert call(address, "DELETE", plan["links"]["self"])[0] == 204
    assert call(address, "GET", plan["links"]["self"])[0] == 404


def test_a_repeated_order_is_the_same_order(address: str) -> None:
    first = call(address, "POST", "/v1/plans", ORDER, **{"Idempotency-Key": "JO-4712"})
    second = call(address, "POST", "/v1/plans", ORDER, **{"Idempotency-Key": "JO-4712"})
    assert (first[0], second[0], first[1]["id"]) == (202, 202, second[1]["id"])


def test_an_order_is_cancelled_once(address: str) -> None:
    plan = call(address, "POST", "/v1/plans", {**ORDER, "external_id": "hang"})[1]
    status, plan, _ = call(address, "POST", f"/v1/plans/{plan['id']}/cancel")
    assert (status, plan["state"]) == (202, "cancelled")
    status, problem, _ = call(address, "POST", f"/v1/plans/{plan['id']}/cancel")
    assert (status, problem["status"], problem["title"]) == (409, 409, "Already finished")


def test_a_wrong_order_is_told_where_it_is_wrong(address: str) -> None:
    status, problem, headers = call(address, "POST", "/v1/plans", {**ORDER, "plate": {"mass": "4"}})
    assert (status, headers["Content-Type"]) == (422, "application/problem+json")
    assert {"/plate/shape", "/plate/mass"} <= {error["pointer"] for error in problem["errors"]}


def test_orders_are_read_page_by_page(address: str) -> None:
    for _ in range(3):
        call(address, "POST", "/v1/plans", {**ORDER, "external_id": "now"})
    _, page, _ = call(address, "GET", "/v1/plans?page_size=2")
    _, rest, _ = call(address, "GET", f"/v1/plans?page_size=2&page_token={page['next_page_token']}")
    assert len({plan["id"] for plan in page["plans"] + rest["plans"]}) == len(page["plans"]) + len(rest["plans"])


@pytest.mark.parametrize("path", ["/livez", "/readyz", "/v1/capabilities", "/openapi.json"])
def test_what_a_monitor_asks_for_is_there(address: str, path: str) -> None:
    assert call(address, "GET", path)[0] == 200


@pytest.mark.slow
def test_a_client_that_is_generated_from_the_description_posts_and_reads_plans(address: str, tmp_path: Path) -> None:
    programs = Path(sys.executable).parent
    command = [programs / "openapi-python-client", "generate", "--path", ROOT / "docs" / "openapi.json"]
    made = subprocess.run(
        [*command, "--output-path", tmp_path / "client", "--meta", "none"],
        env={"PATH": str(programs)},
        capture_output=True,
        text=True,
    )
    assert made.returncode == 0, made.stdout + made.stderr
    task = ROOT / "assets" / "tasks" / "ab1.json"
    used = subprocess.run([sys.executable, "-c", CLIENT, address, task], cwd=tmp_path, capture_output=True, text=True)
    assert used.returncode == 0, used.stderr
