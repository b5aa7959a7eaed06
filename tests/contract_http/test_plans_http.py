"""What a client may rely on, endpoint by endpoint."""

from __future__ import annotations

import base64
import gzip
import json
from datetime import datetime
from typing import get_args

import httpx
import numpy as np
import pytest

from planners.cell.cell import known_cells, load_cell
from planners.contract.shapes import Box
from planners.contract.task_spec import ToolName
from planners.kinematics.forward import flange_pose
from tests.support.service import finished, task, wait_for

ODD_TOKENS = [b"", b"[1" + b"0" * 30 + b', "a"]', b"[" * 3000, b'[1, "\\ud800"]', b"\xff", b"9" * 19 + b"-" + b"a" * 32]


def post(client: httpx.Client, wish: str = "now", **headers: str) -> httpx.Response:
    return client.post(
        "/v1/plans", json=task(external_id=wish), headers={k.replace("_", "-"): v for k, v in headers.items()}
    )


def solved(client: httpx.Client) -> dict:
    answer = post(client, Prefer="wait=60")
    assert answer.status_code == 200
    return answer.json()


def test_a_posted_task_is_accepted_with_the_address_of_its_plan(client: httpx.Client) -> None:
    answer = post(client)
    assert answer.status_code == 202
    plan = answer.json()
    assert answer.headers["Location"] == plan["links"]["self"] == f"/v1/plans/{plan['id']}"
    assert int(answer.headers["Retry-After"]) >= 1
    assert plan["state"] in ("queued", "running")
    assert plan["done"] is False
    assert plan["outcome"] is None
    assert client.get(answer.headers["Location"]).json()["id"] == plan["id"]


def test_a_job_goes_from_queued_to_succeeded_with_times_in_order(client: httpx.Client) -> None:
    plan = finished(client, post(client).json())
    assert (plan["state"], plan["outcome"], plan["attempts"], plan["error"]) == ("succeeded", "solved", 1, None)
    assert plan["progress"]["fraction"] == 1.0
    created, started, ended = (
        datetime.fromisoformat(plan[f"{when}_at"]) for when in ("created", "started", "finished")
    )
    assert created <= started <= ended
    assert created.utcoffset() is not None


def test_waiting_is_honoured_when_asked_for(client: httpx.Client) -> None:
    answer = post(client, Prefer="respond-async, wait=60")
    assert answer.status_code == 200
    assert answer.headers["Preference-Applied"] == "wait=60"
    assert answer.json()["done"] is True
    too_long = post(client, "hang", Prefer="wait=0")
    assert too_long.status_code == 202
    assert "Preference-Applied" not in too_long.headers


def test_the_same_key_and_body_make_one_plan(client: httpx.Client) -> None:
    first, second = post(client, Idempotency_Key='"order-17"'), post(client, Idempotency_Key="order-17")
    assert (first.status_code, second.status_code) == (202, 202)
    assert first.json()["id"] == second.json()["id"]


@pytest.mark.parametrize(
    "prefer", ["wait", "wait=", "wait=-1", "wait=1x", "handling=strict; wait=9", "await=9", "wait=9999999999", ";,="]
)
def test_a_preference_that_is_not_understood_is_ignored(client: httpx.Client, prefer: str) -> None:
    answer = post(client, "hang", Prefer=prefer)
    assert answer.status_code == 202
    client.post(answer.json()["links"]["cancel"])


def test_a_preference_is_found_on_any_of_several_lines(client: httpx.Client) -> None:
    headers = [("Prefer", "respond-async"), ("Prefer", 'wait="60"')]
    answer = client.post("/v1/plans", json=task(external_id="now"), headers=headers)
    assert (answer.status_code, answer.headers["Preference-Applied"]) == (200, "wait=60")


def test_the_same_key_with_another_body_is_refused(client: httpx.Client) -> None:
    post(client, "now", Idempotency_Key="order-18")
    answer = post(client, "later", Idempotency_Key="order-18")
    assert answer.status_code == 422
    assert "Idempotency-Key" in answer.json()["detail"]


def test_a_running_job_tells_when_to_ask_again_and_an_unchanged_plan_is_not_sent_twice(client: httpx.Client) -> None:
    plan = solved(client)
    answer = client.get(plan["links"]["self"])
    assert "Retry-After" not in answer.headers
    again = client.get(plan["links"]["self"], headers={"If-None-Match": answer.headers["ETag"]})
    assert (again.status_code, again.content) == (304, b"")
    assert client.get(plan["links"]["self"], headers={"If-None-Match": '"other"'}).status_code == 200
    running = post(client, "hang").json()
    assert client.get(running["links"]["self"]).headers["Retry-After"] == "1"


def test_the_document_is_the_same_compressed_or_not(client: httpx.Client) -> None:
    plan = solved(client)
    where = plan["links"]["document"]
    plain = client.get(where, headers={"Accept-Encoding": "identity"})
    assert "Content-Encoding" not in plain.headers
    assert plain.json()["id"] == plan["id"]
    with client.stream("GET", where, headers={"Accept-Encoding": "gzip"}) as packed:
        assert packed.headers["Content-Encoding"] == "gzip"
        assert gzip.decompress(b"".join(packed.iter_raw())) == plain.content
    assert client.get(where, headers={"If-None-Match": plain.headers["ETag"]}).status_code == 304


def test_there_is_no_document_before_the_job_has_succeeded(client: httpx.Client) -> None:
    plan = post(client, "hang").json()
    answer = client.get(plan["links"]["document"])
    assert answer.status_code == 404
    assert answer.headers["Retry-After"] == "1"


def test_a_fault_of_the_solver_is_told_in_the_plan_and_gives_no_document(client: httpx.Client) -> None:
    answer = post(client, "fail", Prefer="wait=60")
    assert answer.status_code == 200
    plan = answer.json()
    assert (plan["state"], plan["outcome"], plan["attempts"]) == ("failed", None, 1)
    assert "told to fail" in plan["error"]["detail"]
    assert client.get(plan["links"]["document"]).status_code == 404


def test_a_job_whose_solver_always_dies_is_given_up_after_three_attempts(client: httpx.Client) -> None:
    plan = post(client, "die", Prefer="wait=60").json()
    assert (plan["state"], plan["attempts"]) == ("failed", 3)
    assert "SIGKILL" in plan["error"]["detail"]


def test_plans_are_listed_newest_first_and_every_page_goes_on_where_the_last_one_ended(client: httpx.Client) -> None:
    made = [post(client).json()["id"] for _ in range(5)]
    seen: list[str] = []
    token = None
    while len(seen) < 5:
        page = client.get("/v1/plans", params={"page_size": 2} | ({"page_token": token} if token else {})).json()
        assert len(page["plans"]) == 2
        seen += [plan["id"] for plan in page["plans"]]
        token = page["next_page_token"]
    assert seen[:5] == made[::-1]


def test_the_last_page_has_no_token(client: httpx.Client) -> None:
    page = client.get("/v1/plans", params={"page_size": 200}).json()
    assert page["next_page_token"] is None


def test_cancelling_ends_a_running_job_and_a_queued_one(client: httpx.Client) -> None:
    running, queued = post(client, "hang").json(), post(client, "hang").json()
    wait_for(lambda: client.get(running["links"]["self"]).json()["state"] == "running")
    for plan in (queued, running):
        answer = client.post(plan["links"]["cancel"])
        assert answer.status_code == 202
        assert (answer.json()["state"], answer.json()["done"]) == ("cancelled", True)
        assert answer.json()["finished_at"] is not None
    assert solved(client)["outcome"] == "solved"


def test_a_finished_job_cannot_be_cancelled(client: httpx.Client) -> None:
    plan = solved(client)
    assert client.post(plan["links"]["cancel"]).status_code == 409
    assert client.get(plan["links"]["self"]).json()["state"] == "succeeded"


def test_only_a_finished_plan_can_be_deleted_and_then_it_is_gone(client: httpx.Client) -> None:
    running = post(client, "hang").json()
    assert client.delete(running["links"]["self"]).status_code == 409
    client.post(running["links"]["cancel"])
    plan = solved(client)
    answer = client.delete(plan["links"]["self"])
    assert (answer.status_code, answer.content) == (204, b"")
    for path in plan["links"]["self"], plan["links"]["document"], plan["links"]["events"]:
        assert client.get(path).status_code == 404
    assert client.delete(plan["links"]["self"]).status_code == 404


def test_the_queue_has_an_end(client: httpx.Client) -> None:
    answers = [post(client, "hang") for _ in range(14)]
    assert {answer.status_code for answer in answers} == {202, 429}
    assert answers[-1].headers["Retry-After"]
    assert answers[-1].headers["Content-Type"] == "application/problem+json"


def test_a_key_finds_its_plan_even_when_the_queue_is_full(client: httpx.Client) -> None:
    first = post(client, "hang", Idempotency_Key="order-19")
    while post(client, "hang").status_code == 202:
        pass
    again = post(client, "hang", Idempotency_Key="order-19")
    assert (again.status_code, again.json()["id"]) == (202, first.json()["id"])


def test_capabilities_name_what_can_be_planned(client: httpx.Client) -> None:
    told = client.get("/v1/capabilities").json()
    assert told["kinds"] == ["plate_lift", "suction_tool"]
    assert told["shapes"] == ["box", "cylinder", "prism", "mesh"]
    assert "dual_ur3e_lift" in told["cells"]
    assert told["lifter_models"] == ["paper", "cable", "dexnet"]
    assert told["tools"] == sorted(get_args(ToolName))
    assert "can" in told["meshes"]
    assert {"ab1", "pb1"} < set(told["example_tasks"]["plate_lift"])
    assert {"domino_pile", "can_stack"} < set(told["example_tasks"]["suction_tool"])
    assert told["limits"]["max_body_bytes"] == 2_000_000
    assert told["needs_key"] is False
    assert told["software"]["name"] == "liftwright"


def test_capabilities_tell_where_the_table_is_and_what_each_arm_reaches_and_bears(client: httpx.Client) -> None:
    told = client.get("/v1/capabilities").json()
    assert sorted(told["cell_limits"]) == told["cells"] == sorted(known_cells())
    for name, limits in told["cell_limits"].items():
        cell = load_cell(name)
        # The certificate's own statement of the cell is the other authority.
        bodies, stated = cell.body_documents(), cell.document()
        table = bodies["table"]
        assert isinstance(table.shape, Box)
        for axis, place in (("x", 0), ("y", 1)):
            low, high = limits["table"][axis]
            assert high - low == pytest.approx(table.shape.size[place])
            assert 0.5 * (low + high) == pytest.approx(table.pose[place])
        assert limits["table"]["top"] == pytest.approx(table.pose[2] + 0.5 * table.shape.size[2])
        assert set(limits["arms"]) == set(stated.arms)
        for arm, told_of_arm in limits["arms"].items():
            hand = stated.hands[arm]
            assert told_of_arm["payload"] == stated.arms[arm].payload
            assert told_of_arm["spare_payload"] == pytest.approx(told_of_arm["payload"] - hand.mass, abs=1e-4)
            openings = None if hand.kind != "gripper" else [hand.tcp[:, 0].min(), hand.tcp[:, 0].max()]
            assert told_of_arm["stroke"] == (None if openings is None else pytest.approx(openings))
            of_arm = cell.arms[arm]
            at_home = flange_pose(of_arm.dh, of_arm.T_world_base, of_arm.home)[:3, 3]
            assert np.linalg.norm(at_home - told_of_arm["shoulder"]) < told_of_arm["reach"]


def test_probes_answer_and_metrics_count(client: httpx.Client) -> None:
    solved(client)
    assert client.get("/livez").status_code == client.get("/readyz").status_code == 200
    counts = dict(line.rsplit(" ", 1) for line in client.get("/metrics").text.splitlines() if not line.startswith("#"))
    assert float(counts['liftwright_documents{outcome="solved"}']) >= 1


def test_the_description_is_openapi_3_1_and_every_reference_in_it_leads_somewhere(client: httpx.Client) -> None:
    description = client.get("/openapi.json").json()
    assert description["openapi"].startswith("3.1")
    text = json.dumps(description)
    for name in {piece.split('"')[0] for piece in text.split("#/components/schemas/")[1:]}:
        assert name in description["components"]["schemas"], name
    assert "#/$defs/" not in text
    assert set(description["paths"]["/v1/plans/{plan_id}"]) == {"get", "delete"}


def test_the_description_has_what_goes_in_and_what_comes_out(client: httpx.Client) -> None:
    description = client.get("/openapi.json").json()
    schemas = description["components"]["schemas"]
    answers = description["paths"]["/v1/plans/{plan_id}/document"]["get"]["responses"]
    assert answers["200"]["content"]["application/json"]["schema"] == {"$ref": "#/components/schemas/PlanDocument"}
    assert {"segments", "certificate", "simulation"} <= set(schemas["PlanDocument"]["required"])
    # Members have their names in JSON, not those in Python.
    assert "with" in schemas["ContactState"]["properties"]


@pytest.mark.parametrize("path", ["/v1/nothing", "/v1/plans/", "/v1/plans/unknown", "/v1/plans/unknown/document"])
def test_what_does_not_exist_is_a_404_as_problem_json(client: httpx.Client, path: str) -> None:
    answer = client.get(path)
    assert answer.status_code == answer.json()["status"] == 404
    assert answer.headers["Content-Type"] == "application/problem+json"


@pytest.mark.parametrize("method", ["PUT", "OPTIONS", "PATCH"])
@pytest.mark.parametrize(
    ("path", "allowed"),
    [
        ("/v1/plans", "GET, HEAD, POST"),
        ("/v1/plans/some", "DELETE, GET, HEAD"),
        ("/v1/plans/some/cancel", "POST"),
        ("/livez", "GET, HEAD"),
    ],
)
def test_a_wrong_method_is_told_which_ones_are_right(
    client: httpx.Client, method: str, path: str, allowed: str
) -> None:
    answer = client.request(method, path)
    assert answer.status_code == answer.json()["status"] == 405
    assert answer.headers["Allow"] == allowed
    assert answer.headers["Content-Type"] == "application/problem+json"


@pytest.mark.parametrize(
    ("params", "status"),
    [
        ({"page_size": 0}, 422),
        ({"page_size": "many"}, 422),
        ({"page_token": "%%%"}, 400),
        *(({"page_token": base64.urlsafe_b64encode(text).decode()}, 400) for text in ODD_TOKENS),
    ],
)
def test_parameters_that_cannot_be_followed_are_refused(client: httpx.Client, params: dict, status: int) -> None:
    answer = client.get("/v1/plans", params=params)
    assert answer.status_code == status
    assert answer.headers["Content-Type"] == "application/problem+json"
