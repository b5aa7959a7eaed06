"""What a client may rely on of studies, endpoint by endpoint."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from typing import Any

import cv2
import httpx
import numpy as np
import pytest

from app.settings import ServiceSettings
from tests.support.own_cell import station
from tests.support.places import database_at
from tests.support.service import FAKE_EXAMINER, FAKE_SOLVER, finished, task, wait_for
from tests.support.serving import served

X = {"pointer": "/cup/position/0", "min": -0.1, "max": 0.1, "count": 5}
Y = {"pointer": "/cup/position/1", "values": [-0.05, 0, 0.05]}


@pytest.fixture(scope="module")
def address(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    fakes = {"solver_command": FAKE_SOLVER, "study_command": FAKE_EXAMINER}
    limits = {"worker_slots": 1, "study_slots": 2, "max_studies": 3, "max_study_points": 60}
    with database_at("sqlite") as place:
        data_dir = tmp_path_factory.mktemp("data")
        with served(ServiceSettings.model_validate({"data_dir": data_dir, **fakes, **limits, **place})) as address:
            yield address


@pytest.fixture
def client(address: str) -> Iterator[httpx.Client]:
    """Talk to it; what a test leaves unfinished is cancelled."""
    with httpx.Client(base_url=address, timeout=90.0) as client:
        yield client
        for study in client.get("/v1/studies", params={"page_size": 200}).json()["studies"]:
            if not study["done"]:
                client.post(study["links"]["cancel"])


def post(client: httpx.Client, wish: str = "now", axes: Any = (X, Y), **headers: str) -> httpx.Response:
    body = {"task": task(external_id=wish), "axes": list(axes), "external_id": "mine"}
    return client.post("/v1/studies", json=body, headers={k.replace("_", "-"): v for k, v in headers.items()})


def done(client: httpx.Client, wish: str = "now", axes: Any = (X, Y)) -> dict[str, Any]:
    address = post(client, wish, axes).json()["links"]["self"]
    # The least of priorities: beside other work it may take its time.
    wait_for(lambda: client.get(address).json()["done"], 300)
    return client.get(address).json()


@pytest.mark.slow
def test_a_study_that_is_waited_for_is_answered_with_its_end(client: httpx.Client) -> None:
    answer = post(client, axes=(X,), Prefer="wait=60")
    assert (answer.status_code, answer.json()["done"]) == (200, True)


@pytest.mark.slow
def test_a_study_is_accepted_with_its_address_and_ends_with_all_points(client: httpx.Client) -> None:
    answer = post(client)
    assert answer.status_code == 202
    study = answer.json()
    assert answer.headers["Location"] == study["links"]["self"] == f"/v1/studies/{study['id']}"
    ended = finished(client, study)
    assert (ended["state"], ended["count"], ended["known"], ended["external_id"]) == ("succeeded", 15, 15, "mine")
    found = client.get(study["links"]["map"]).json()
    assert [point["index"] for point in found["points"]] == list(range(15))
    assert [axis["values"] for axis in found["axes"]] == [[-0.1, -0.05, 0.0, 0.05, 0.1], Y["values"]]
    assert found["outcomes"] == {"solved": 10, "infeasible": 0, "not_found": 5, "refused": 0, "failed": 0}
    assert (found["best"]["index"], found["best"]["values"]) == (13, [0.1, 0])


@pytest.mark.slow
def test_the_best_point_is_planned_with_its_values(client: httpx.Client) -> None:
    study = done(client)
    plan = finished(client, {"links": {"self": study["best_plan"]}})
    assert plan["outcome"] == "solved"
    planned = client.get(plan["links"]["document"]).json()["task"]
    assert planned["cup"]["position"] == [0.1, 0]
    asked = client.post(f"{study['links']['points']}/13/plan")
    assert (asked.status_code, asked.json()["id"]) == (200, plan["id"])
    assert plan["study_id"] == study["id"]


@pytest.mark.slow
def test_any_point_is_planned_when_it_is_asked_for_and_once(client: httpx.Client) -> None:
    study = done(client)
    first, second = (client.post(f"{study['links']['points']}/4/plan") for _ in range(2))
    assert first.status_code == 202
    assert first.headers["Location"] == first.json()["links"]["self"] == second.json()["links"]["self"]
    ended = finished(client, first.json())
    assert client.get(ended["links"]["document"]).json()["task"]["cup"]["position"] == [-0.05, 0]
    for missing in ("15/plan", "1000000/plan"):
        assert client.post(f"{study['links']['points']}/{missing}").status_code == 404


def test_a_point_that_can_have_no_task_has_no_plan_whether_it_is_examined_or_not(client: httpx.Client) -> None:
    support = {"shape": {"type": "box", "size": [0.3, 0.3, 0.02]}, "pose": [0.36, 0, 1.11, 1, 0, 0, 0]}
    heights = {"pointer": "/support/pose/2", "min": 1.11, "max": 1.2, "count": 20}
    body = {
        "task": {**task(external_id="slow"), "support": support},
        "axes": [{"pointer": "/support", "values": [support, None]}, heights],
    }
    study = client.post("/v1/studies", json=body).json()
    refused = client.post(f"{study['links']['points']}/39/plan")
    assert refused.status_code == 404
    assert "no plan of point 39: /support/pose/2" in refused.json()["detail"]


@pytest.mark.slow
def test_events_are_the_points_as_they_come_and_can_be_resumed(client: httpx.Client) -> None:
    study = done(client)

    def events(**headers: str) -> list[dict[str, str]]:
        text = client.get(study["links"]["events"], headers=headers).text
        return [dict(line.split(": ", 1) for line in block.splitlines()) for block in text.strip().split("\n\n")]

    whole = events()
    assert [event["event"] for event in whole] == ["point"] * 15 + ["finished"]
    assert [int(event["id"]) for event in whole] == list(range(1, 17))
    assert {json.loads(event["data"])["index"] for event in whole[:15]} == set(range(15))
    assert json.loads(whole[-1]["data"])["id"] == study["id"]
    assert events(**{"Last-Event-ID": "12"}) == whole[12:]
    assert client.get(study["links"]["events"], headers={"Last-Event-ID": "16"}).status_code == 204
    assert client.get(study["links"]["events"], headers={"Last-Event-ID": "99"}).status_code == 400


def test_a_map_that_is_not_whole_has_what_is_known_and_a_cancelled_study_keeps_it(client: httpx.Client) -> None:
    study = post(client, "slow", [X, {**Y, "values": [0.01 * step for step in range(10)]}]).json()
    wait_for(lambda: client.get(study["links"]["self"]).json()["known"] >= 3)
    partial = client.get(study["links"]["map"]).json()
    assert 0 < partial["done"] < partial["count"] == 50
    cancelled = client.post(study["links"]["cancel"])
    assert (cancelled.status_code, cancelled.json()["state"]) == (202, "cancelled")
    assert client.get(study["links"]["map"]).json()["done"] >= partial["done"]
    assert client.post(study["links"]["cancel"]).status_code == 409


@pytest.mark.slow
def test_a_study_is_deleted_once_it_has_ended(client: httpx.Client) -> None:
    running = post(client, "hang", [X]).json()
    assert client.delete(running["links"]["self"]).status_code == 409
    study = done(client)
    assert client.delete(study["links"]["self"]).status_code == 204
    for link in ("self", "map", "picture", "events"):
        assert client.get(study["links"][link]).status_code == 404
    kept = client.get(study["best_plan"])
    assert (kept.status_code, kept.json()["study_id"]) == (200, None)


@pytest.mark.slow
def test_a_point_at_which_the_solver_dies_is_told_and_the_others_are_found(client: httpx.Client) -> None:
    for wish, why in (("die-7", "given up after 3 attempts"), ("fail-7", "told to fail")):
        study = done(client, wish)
        points = client.get(study["links"]["map"]).json()["points"]
        assert study["state"] == "succeeded"
        assert [point["index"] for point in points if point["outcome"] == "failed"] == [7]
        assert why in points[7]["summary"]


def test_the_same_key_makes_one_study_and_is_not_taken_for_another(client: httpx.Client) -> None:
    first, second = (post(client, Idempotency_Key="study-17") for _ in range(2))
    assert first.json()["id"] == second.json()["id"]
    assert post(client, axes=[X], Idempotency_Key="study-17").status_code == 422
    in_other_words = post(client, axes=[X, {**Y, "values": [-0.05, 0.0, 0.05]}], Idempotency_Key="study-17")
    assert (in_other_words.status_code, in_other_words.json()["id"]) == (202, first.json()["id"])


def test_cells_that_are_compared_are_named_for_good_and_must_be_there(client: httpx.Client) -> None:
    own = client.post("/v1/cells", json=station()).raise_for_status().json()
    cells = {"pointer": "/cell", "values": ["dual_ur3e_lift", own["name"], own["id"]]}
    study = post(client, "slow", axes=[cells]).raise_for_status().json()
    (axis,) = client.get(study["links"]["map"]).json()["axes"]
    assert axis["values"] == ["dual_ur3e_lift", own["id"], own["id"]]
    refused = post(client, axes=[X, {"pointer": "/cell", "values": ["dual_ur3e_lift", "moon_base"]}])
    assert refused.status_code == 422
    (error,) = refused.json()["errors"]
    assert error["pointer"] == "/axes/1/values/1"
    assert {"dual_ur3e_lift", own["name"]} <= set(error["allowed"])


@pytest.mark.slow
def test_a_study_tells_of_no_best_plan_that_was_deleted(client: httpx.Client) -> None:
    study = done(client, axes=[X])
    finished(client, {"links": {"self": study["best_plan"]}})
    assert client.delete(study["best_plan"]).status_code == 204
    assert client.get(study["links"]["self"]).json()["best_plan"] is None


@pytest.mark.slow
def test_studies_are_listed_newest_first_page_by_page(client: httpx.Client) -> None:
    made = [done(client, axes=[X])["id"] for _ in range(3)]
    found: list[str] = []
    token: str | None = None
    while True:
        page = client.get("/v1/studies", params={"page_size": 2} | ({"page_token": token} if token else {})).json()
        found += [study["id"] for study in page["studies"]]
        token = page["next_page_token"]
        if token is None:
            break
    assert found[:3] == made[::-1]
    assert len(set(found)) == len(found)


@pytest.mark.parametrize(
    ("body", "pointer"),
    [
        ({}, "/task"),
        ({"task": {"kind": "plate_lift"}, "axes": [X]}, "/task/plate"),
        ({"task": task(cell="moon_base"), "axes": [X]}, "/task/cell"),
        ({"task": task(), "axes": [{"pointer": "/cup/place", "values": [1]}]}, "/axes/0/pointer"),
        ({"task": task("can_stack.json"), "axes": [{"pointer": "/scene_id", "values": ["0" * 32]}]}, "/axes/0/pointer"),
        ({"task": task(), "axes": [X, {"pointer": "/lifter_model", "values": ["balloon"]}]}, "/axes/1/values/0"),
    ],
)
def test_a_study_that_cannot_be_begun_is_refused_where_it_is_wrong(
    client: httpx.Client, body: dict[str, Any], pointer: str
) -> None:
    answer = client.post("/v1/studies", json=body)
    assert answer.status_code == 422
    assert pointer in [error["pointer"] for error in answer.json()["errors"]]


def test_limits_are_told_with_what_is_allowed(client: httpx.Client) -> None:
    limits = client.get("/v1/capabilities").json()["limits"]
    assert (limits["max_studies"], limits["max_study_points"]) == (3, 60)
    large = post(client, axes=[{**X, "count": 61}])
    assert large.status_code == 422
    assert "61 points; 1 to 60 are allowed" in large.json()["detail"]
    for _ in range(3):
        assert post(client, "hang").status_code == 202
    refused = post(client)
    assert (refused.status_code, "Retry-After" in refused.headers) == (429, True)


def test_the_picture_shows_what_is_solved_apart_from_what_is_not_in_grey_too(client: httpx.Client) -> None:
    study = done(client, axes=[X])
    answer = client.get(study["links"]["picture"])
    assert answer.headers["Content-Type"] == "image/png"
    image = cv2.imdecode(np.frombuffer(answer.content, np.uint8), cv2.IMREAD_COLOR)
    assert image is not None
    grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    spread = image.max(axis=2).astype(int) - image.min(axis=2)
    # The colours of what is solved are colourful, and darker than the grey of what was not found.
    assert spread.max() > 60
    assert np.median(grey[spread > 60]) < 200


@pytest.mark.slow
def test_points_are_counted_in_the_metrics(client: httpx.Client) -> None:
    done(client)
    lines = client.get("/metrics").text.splitlines()
    assert any(line.startswith('liftwright_study_points_total{outcome="solved"}') for line in lines)


@pytest.mark.slow
def test_parts_that_wait_or_run_are_in_the_metrics_and_are_no_jobs(client: httpx.Client) -> None:
    """Two places for parts, and twelve points to each."""

    def told() -> dict[str, float]:
        samples = re.findall(
            r'^liftwright_(study_parts|jobs)\{state="(\w+)"\} (\S+)$', client.get("/metrics").text, re.M
        )
        return {f"{family} {state}": float(value) for family, state, value in samples}

    wait_for(lambda: set(told().values()) == {0.0}, 60.0)
    post(client, "hang", axes=[{**X, "count": 48}])
    wait_for(lambda: told()["study_parts running"] == 2, 20.0)
    now = told()
    assert now.pop("study_parts running") == now.pop("study_parts queued") == 2
    assert set(now.values()) == {0.0}


def test_plans_go_on_while_studies_fill_all_places(client: httpx.Client) -> None:
    for _ in range(2):
        post(client, "hang")
    plan = client.post("/v1/plans", json=task(external_id="now"), headers={"Prefer": "wait=60"})
    assert plan.json()["outcome"] == "solved"
