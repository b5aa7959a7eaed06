"""Posting scans over HTTP, and tasks that name the scenes."""

from __future__ import annotations

import json
import time
from http.client import HTTPConnection
from typing import Any

import cv2
import httpx
import numpy as np
import pytest

from app.cli.service_client import ServiceClient
from app.demo import post_scan
from tests.support.scan_frames import SHIPPED, shipped

SCAN = shipped()
TASK = json.loads((SHIPPED / "tissue_boxes" / "task.json").read_text())


def post(client: httpx.Client, description: Any = None, **files: bytes) -> httpx.Response:
    described = description if isinstance(description, bytes) else json.dumps(description or SCAN.description).encode()
    form = {"scan": ("scan.json", described, "application/json")}
    return client.post("/v1/scenes", files=form | {name: (name, content) for name, content in files.items()})


@pytest.fixture(scope="module")
def scene(address: str) -> dict[str, Any]:
    with httpx.Client(base_url=address, timeout=60.0) as client:
        answer = post(client, **SCAN.files)
    assert answer.status_code == 201, answer.text
    assert answer.headers["location"] == answer.json()["links"]["self"]
    return answer.json()


def test_a_scan_becomes_a_scene_that_can_be_fetched(client: httpx.Client, scene: dict[str, Any]) -> None:
    assert scene["scene"]["tool"]["name"] == "long_symmetric"
    assert [each["shape"]["type"] for each in scene["scene"]["objects"]] == ["box"] * 3
    assert {each["supported_by"] for each in scene["scene"]["objects"]} == {"table"}
    assert all(each["support_points"] for each in scene["scene"]["objects"])
    assert client.get(scene["links"]["self"]).json() == scene


def test_the_same_scan_gives_the_same_scene(client: httpx.Client, scene: dict[str, Any]) -> None:
    assert post(client, **SCAN.files).json() == scene


def test_a_scene_has_a_picture_with_the_detections_drawn_in(client: httpx.Client, scene: dict[str, Any]) -> None:
    answer = client.get(scene["links"]["preview"])
    assert (answer.status_code, answer.headers["content-type"]) == (200, "image/png")
    image = cv2.imdecode(np.frombuffer(answer.content, np.uint8), cv2.IMREAD_COLOR)
    assert image is not None
    green = (image[..., 1] > 180) & (image[..., 2] < 120)
    assert green.sum() > 500


def test_a_task_may_name_a_scene_in_place_of_shapes_and_poses(client: httpx.Client, scene: dict[str, Any]) -> None:
    answer = client.post("/v1/plans", json={**TASK, "scene_id": scene["id"]})
    assert answer.status_code == 202, answer.text


def test_an_accepted_task_is_posted_again_as_it_is_or_changed_and_takes_nothing_from_its_scene_twice(
    client: httpx.Client, scene: dict[str, Any]
) -> None:
    def accepted(task: dict[str, Any]) -> dict[str, Any]:
        plan = client.post("/v1/plans", json=task)
        assert plan.status_code == 202, plan.text
        return client.post("/v1/tasks/check", json=task).raise_for_status().json()["task"]

    # One object of three: the others are obstacles.
    first = accepted({**TASK, "scene_id": scene["id"], "objects": TASK["objects"][:1]})
    assert len(first["obstacles"]) == len(scene["scene"]["objects"]) - 1
    assert accepted(first) == first
    (item,), (_, *others) = first["objects"], first["obstacles"]
    x, *rest = item["pose"]
    moved = {**first, "objects": [{**item, "pose": [x - 0.002, *rest]}], "obstacles": others}
    assert accepted(moved) == moved
    gone = {**first, "scene_id": "0" * 32}
    assert accepted(gone) == gone


def test_the_demo_posts_a_scan_and_the_task_of_its_scene(
    address: str, scene: dict[str, Any], capsys: pytest.CaptureFixture[str]
) -> None:
    plan = post_scan(ServiceClient(address), SHIPPED / "tissue_boxes")
    told = capsys.readouterr().out
    assert all(each["name"] in told for each in scene["scene"]["objects"])
    with httpx.Client(base_url=address) as client:
        assert client.get(plan.links.self).json()["external_id"] == TASK["external_id"]
        for line in ("viewer:", "picture:", "posted:"):
            where = next(words.split()[1] for words in told.splitlines() if words.startswith(line))
            assert client.get(where.removeprefix(address), follow_redirects=True).status_code == 200


@pytest.mark.parametrize(
    ("change", "pointer"),
    [
        ({"scene_id": "unknown"}, "/scene_id"),
        ({"scene_id": 7}, "/scene_id"),
        ({"cell": "dual_ur3e_lift"}, "/cell"),
        ({"scene_id": None}, "/scene_id"),
        ({"objects": [{**TASK["objects"][0], "detection": "object_9"}]}, "/objects/0/detection"),
        ({"objects": [TASK["objects"][0], {**TASK["objects"][0], "name": "b"}]}, "/objects/1/detection"),
        ({"objects": [{"detection": "object_1", "goal_pose": TASK["objects"][0]["goal_pose"]}]}, "/objects/0/mass"),
        ({"objects": [7]}, "/objects/0"),
        ({"objects": {}}, "/objects"),
        ({"objects": [{**TASK["objects"][0], "goal_pose": "here"}]}, "/objects/0/goal_pose"),
    ],
)
def test_a_task_that_does_not_fit_its_scene_is_refused_where_it_is_wrong(
    client: httpx.Client, scene: dict[str, Any], change: dict[str, Any], pointer: str
) -> None:
    answer = client.post("/v1/plans", json={**TASK, "scene_id": scene["id"], **change})
    assert answer.status_code == 422, answer.text
    assert pointer in [error["pointer"] for error in answer.json()["errors"]]


@pytest.mark.slow
def test_a_scene_is_of_the_version_of_its_cell_that_it_was_perceived_in(client: httpx.Client) -> None:
    def add(gravity: float) -> str:
        hands = {arm: {"robot": "ur3e", "hand": "robotiq_2f85_ft300"} for arm in ("left", "right")}
        rest = {"position": [0.22, 0.0], "clearance": 0.024, "height": 0.050, "thickness": 0.005}
        cell = {"name": "eyes", "mount": "dual_column", "arms": hands, "gravity": [0, 0, gravity], "tool_rest": rest}
        return client.post("/v1/cells", json=cell).raise_for_status().json()["id"]

    def perceived() -> dict[str, Any]:
        return post(client, {**SCAN.description, "cell": "eyes"}, **SCAN.files).raise_for_status().json()

    def checked(**members: Any) -> dict[str, Any]:
        return client.post("/v1/tasks/check", json={**TASK, **members}).raise_for_status().json()

    first_cell = add(-9.81)
    first = perceived()
    assert first["scene"]["cell"] == first_cell
    second_cell = add(-9.8)
    second = perceived()
    assert (second["scene"]["cell"], second["id"] != first["id"]) == (second_cell, True)
    assert checked(scene_id=first["id"])["task"]["cell"] == first_cell
    for scene, cell in ((first, first_cell), (second, "eyes"), (second, second_cell)):
        assert checked(scene_id=scene["id"], cell=cell)["task"]["cell"] == scene["scene"]["cell"]
    for scene, cell in ((first, "eyes"), (second, first_cell)):
        assert [each["pointer"] for each in checked(scene_id=scene["id"], cell=cell)["errors"]] == ["/cell"]


DEPTH_ONLY = {"depth": SCAN.description["depth"]}
CLOUD_ONLY = {"cloud": {"pose": SCAN.description["depth"]["pose"]}}
COLOUR_ONLY = {"colour": SCAN.description["colour"]}
LONG = cv2.imencode(".png", np.zeros((100, 60_000, 3), np.uint8))[1].tobytes()
PLY = b"ply\nformat binary_little_endian 1.0\nelement vertex %d\nproperty float x\nproperty float y\nproperty float z\n"


@pytest.mark.parametrize(
    ("description", "files", "status", "said"),
    [
        (b"{", SCAN.files, 400, "not JSON"),
        ({}, {}, 422, "at least one of colour, depth and cloud"),
        (DEPTH_ONLY, {}, 422, "no such file"),
        (DEPTH_ONLY, {"depth": b""}, 422, "neither a PNG nor a JPEG"),
        (DEPTH_ONLY, {"depth": b"\x89PNG\r\n\x1a\n" + b"x" * 100}, 422, "neither a PNG nor a JPEG"),
        (DEPTH_ONLY, {"depth": SCAN.files["depth"][:2000]}, 422, "depth"),
        (DEPTH_ONLY, {"depth": SCAN.files["colour"]}, 422, "16 bits"),
        (COLOUR_ONLY, {"colour": LONG}, 422, "/colour: the image has 60000 x 100 pixels; its sides are 16 to 10,000"),
        (DEPTH_ONLY, {"depth": LONG}, 422, "/depth: the image has 60000 x 100 pixels"),
        (DEPTH_ONLY, SCAN.files, 422, "does not say what camera"),
        ({**DEPTH_ONLY, "cell": "nowhere"}, {"depth": SCAN.files["depth"]}, 422, "no cell"),
        (CLOUD_ONLY, {"cloud": PLY % 50_000_000 + b"end_header\n"}, 422, "50,000,000 points"),
        (CLOUD_ONLY, {"cloud": PLY % 0 + b"end_header\n"}, 422, "/cloud: 0 points"),
        (CLOUD_ONLY, {"cloud": PLY % 9 + b"end_header\n" + b"\0" * 20}, 422, "cut short"),
        (CLOUD_ONLY, {"cloud": PLY % 900 + b"end_header\n" + b"\xff" * 10800}, 422, "0 points"),
        (CLOUD_ONLY, {"cloud": b"solid"}, 422, "neither PLY, PCD nor NPY"),
    ],
)  # fmt: skip
def test_a_scan_that_cannot_be_read_is_refused_with_the_reason(
    client: httpx.Client, description: Any, files: dict[str, bytes], status: int, said: str
) -> None:
    described = description if isinstance(description, bytes) else json.dumps(description).encode()
    answer = post(client, described, **files)
    assert answer.status_code == answer.json()["status"] == status, answer.text
    assert answer.headers["content-type"] == "application/problem+json"
    assert said in answer.text


def test_a_scan_that_is_no_form_is_refused(client: httpx.Client) -> None:
    assert client.post("/v1/scenes", json={}).status_code == 415
    assert client.post("/v1/scenes", files={"depth": b"x"}).status_code == 422
    assert client.post("/v1/scenes", files=[("scan", b"{}"), ("scan", b"{}")]).status_code == 422
    assert client.post("/v1/scenes", files={"film": b"x"}).status_code == 422


def test_a_scan_that_is_too_large_is_refused_unread(address: str) -> None:
    connection = HTTPConnection(address.removeprefix("http://"), timeout=30.0)
    connection.putrequest("POST", "/v1/scenes")
    for name, value in (("Content-Type", "multipart/form-data; boundary=x"), ("Content-Length", str(600_000_000))):
        connection.putheader(name, value)
    connection.endheaders()
    assert connection.getresponse().status == 413
    connection.close()


@pytest.mark.parametrize("path", ["/v1/scenes/unknown", "/v1/scenes/unknown/preview.png", "/v1/scenes/unknown/view"])
def test_a_scene_that_does_not_exist_is_a_404(client: httpx.Client, path: str) -> None:
    assert client.get(path).status_code == 404


@pytest.mark.slow
def test_a_list_has_every_scene_once_page_by_page_the_newest_first(client: httpx.Client) -> None:
    posted = [
        post(client, {**SCAN.description, "external_id": f"listed {index}"}, **SCAN.files).json() for index in range(3)
    ]
    listed: list[dict[str, Any]] = []
    parameters: dict[str, Any] = {"page_size": 2}
    while True:
        page = client.get("/v1/scenes", params=parameters).raise_for_status().json()
        assert len(page["scenes"]) <= 2
        listed += page["scenes"]
        if page["next_page_token"] is None:
            break
        parameters["page_token"] = page["next_page_token"]
    ids = [each["id"] for each in listed]
    assert ids[:3] == [each["id"] for each in reversed(posted)]
    assert len(set(ids)) == len(ids)
    assert [each["external_id"] for each in listed[:3]] == ["listed 2", "listed 1", "listed 0"]
    assert {each["objects"] for each in listed[:3]} == {3}
    assert client.get("/v1/scenes", params={"page_token": "x"}).status_code == 400


@pytest.mark.slow
def test_a_deleted_scene_is_gone_and_its_scan_gives_it_again(client: httpx.Client) -> None:
    description = {**SCAN.description, "external_id": "doomed"}
    scene = post(client, description, **SCAN.files).json()
    assert client.delete(scene["links"]["self"]).status_code == 204
    for link in scene["links"].values():
        assert client.get(link).status_code == 404
    assert client.delete(scene["links"]["self"]).status_code == 404
    assert client.post("/v1/plans", json={**TASK, "scene_id": scene["id"]}).status_code == 422
    assert post(client, description, **SCAN.files).json()["id"] == scene["id"]


def test_a_scene_stays_while_the_job_of_a_task_that_names_it_has_not_ended(client: httpx.Client) -> None:
    scene = post(client, {**SCAN.description, "external_id": "used"}, **SCAN.files).json()
    plan = client.post("/v1/plans", json={**TASK, "scene_id": scene["id"], "external_id": "hang"}).json()
    refused = client.delete(scene["links"]["self"])
    assert refused.status_code == 409
    assert plan["id"] in refused.json()["detail"]
    client.post(plan["links"]["cancel"])
    assert client.delete(scene["links"]["self"]).status_code == 204
    assert client.get(plan["links"]["self"]).status_code == 200


def test_senders_who_are_slow_keep_nobody_from_having_a_scan_perceived(address: str, client: httpx.Client) -> None:
    slow = [HTTPConnection(address.removeprefix("http://"), timeout=30.0) for _ in range(4)]
    try:
        for connection in slow:
            connection.putrequest("POST", "/v1/scenes")
            connection.putheader("Content-Type", "multipart/form-data; boundary=x")
            connection.putheader("Content-Length", "1000")
            connection.endheaders(b"--x")
        begun = time.monotonic()
        assert post(client, {**SCAN.description, "external_id": "quick"}, **SCAN.files).status_code == 201
        assert time.monotonic() - begun < 8.0
    finally:
        for connection in slow:
            connection.close()
