"""Bad bodies: each gets a clear 4xx in under a second, and the service goes on."""

from __future__ import annotations

import gzip
import json
import socket
import time
from typing import Any

import httpx
import pytest

from planners.program import ProgramTarget
from tests.support.service import task

LONGEST_SECONDS = 1.0

BOX = {"type": "box", "size": [0.05, 0.05, 0.05]}


def _plate(**members: Any) -> dict[str, Any]:
    return {**task()["plate"], **members}


MEANINGLESS: dict[str, tuple[Any, str]] = {
    "a body that is no object": ([], ""),
    "no members at all": ({}, "/kind"),
    "an unknown kind": (task(kind="dance"), "/kind"),
    "a text instead of a number": (task(plate=_plate(mass="4")), "/plate/mass"),
    "a boolean instead of a number": (task(plate=_plate(mass=True)), "/plate/mass"),
    "a missing member": (task(plate={"shape": task()["plate"]["shape"]}), "/plate/mass"),
    "an unknown member": (task(colour="red"), "/colour"),
    "an unknown member deep inside": (task(plate=_plate(colour="red")), "/plate/colour"),
    "a negative size": (task(plate=_plate(shape={"type": "box", "size": [-0.3, 0.3, 0.04]})), "/plate/shape/size/0"),
    "an absurd size": (task(plate=_plate(shape={"type": "box", "size": [1e300, 0.3, 0.04]})), "/plate/shape/size/0"),
    "a plate through the table": (task(plate_pose=[0.3, 0, 1.08, 1, 0, 0, 0]), "/plate_pose"),
    "a plate in the air": (task(plate_pose=[0.3, 0, 1.5, 1, 0, 0, 0]), "/plate_pose"),
    "a cup off the plate": (task(cup={**task()["cup"], "position": [0.4, 0]}), "/cup/position"),
    "an unknown cell": (task(cell="moon_base"), "/cell"),
    "an unknown lifter model": (task(lifter_model="balloon"), "/lifter_model"),
    "a quaternion that is none": (task(plate_pose=[0.3, 0, 1.114, 0.5, 0, 0, 0]), "/plate_pose"),
    "a support in the air": (
        task(support={"shape": {"type": "box", "size": [0.4, 0.5, 0.044]}, "pose": [0.3, 0, 1.3, 1, 0, 0, 0]}),
        "/support/pose",
    ),
    "a support smaller than the plate": (
        task(
            "ab3.json",
            support={"shape": {"type": "box", "size": [0.1, 0.1, 0.044]}, "pose": [0.3, 0, 1.116, 1, 0, 0, 0]},
        ),
        "/support/shape",
    ),
    "a name twice": (
        task(obstacles=[{"name": "a", "shape": BOX, "pose": [x, 0.7, 1.3, 1, 0, 0, 0]} for x in (0.2, 0.4)]),
        "/obstacles/1/name",
    ),
    "ten thousand obstacles": (
        task(obstacles=[{"name": f"o{i}", "shape": BOX, "pose": [0.3, 0.7, 1.3, 1, 0, 0, 0]} for i in range(10_000)]),
        "/obstacles",
    ),
    "an hour of nothing in a name": (task(external_id="x" * 100_000), "/external_id"),
}
NOT_JSON = {
    "nothing": b"",
    "half an object": b'{"kind": "plate_lift"',
    "NaN": json.dumps(task(plate=_plate(mass=float("nan")))).encode(),
    "infinity": json.dumps(task(plate=_plate(mass=float("inf")))).encode(),
    "a key twice": b'{"kind": "plate_lift", "kind": "plate_lift"}',
    "another encoding": '{"kind": "pläte"}'.encode("utf-16"),
    "ten thousand brackets": b"[" * 10_000,
}


def post(client: httpx.Client, body: bytes, media_type: str | None = "application/json") -> httpx.Response:
    begun = time.perf_counter()
    answer = client.post("/v1/plans", content=body, headers={"Content-Type": media_type} if media_type else {})
    assert time.perf_counter() - begun < LONGEST_SECONDS
    if answer.status_code != 202:
        assert answer.headers["Content-Type"] == "application/problem+json"
        assert answer.json()["status"] == answer.status_code
    return answer


@pytest.fixture(autouse=True)
def _goes_on(client: httpx.Client) -> Any:
    yield
    assert post(client, json.dumps(task(external_id="now")).encode()).status_code == 202


@pytest.mark.parametrize(("body", "pointer"), MEANINGLESS.values(), ids=MEANINGLESS)
def test_a_meaningless_task_is_refused_with_a_pointer(client: httpx.Client, body: Any, pointer: str) -> None:
    answer = post(client, json.dumps(body).encode())
    assert answer.status_code == 422
    errors = answer.json()["errors"]
    assert pointer in [error["pointer"] for error in errors]
    assert all(error["detail"] for error in errors)


def test_choices_are_named(client: httpx.Client) -> None:
    (error,) = post(client, json.dumps(task(cell="moon_base")).encode()).json()["errors"]
    assert "dual_ur3e_lift" in error["allowed"]


@pytest.mark.parametrize("body", NOT_JSON.values(), ids=NOT_JSON)
def test_what_is_not_json_is_a_400(client: httpx.Client, body: bytes) -> None:
    assert post(client, body).status_code == 400


@pytest.mark.parametrize("media_type", [None, "text/plain", "application/x-www-form-urlencoded", "multipart/form-data"])
def test_another_media_type_is_a_415(client: httpx.Client, media_type: str | None) -> None:
    answer = post(client, json.dumps(task()).encode(), media_type)
    assert answer.status_code == 415
    assert answer.headers["Accept-Post"] == "application/json"


def test_a_charset_beside_the_media_type_is_no_fault(client: httpx.Client) -> None:
    assert post(client, json.dumps(task()).encode(), "application/json; charset=utf-8").status_code == 202


def test_ten_megabytes_are_a_413_with_a_declared_length_and_without(client: httpx.Client) -> None:
    body = json.dumps(task(external_id="x" * 10_000_000)).encode()
    assert post(client, body).status_code == 413
    begun = time.perf_counter()
    pieces = (body[i : i + 65536] for i in range(0, len(body), 65536))
    answer = client.post("/v1/plans", content=pieces, headers={"Content-Type": "application/json"})
    assert answer.status_code == 413
    assert time.perf_counter() - begun < LONGEST_SECONDS


def test_a_number_beyond_all_bounds_is_no_finite_number(client: httpx.Client) -> None:
    body = json.dumps(task(plate=_plate(mass=12345))).replace("12345", "1e999").encode()
    (error,) = post(client, body).json()["errors"]
    assert error["pointer"] == "/plate/mass"


def test_a_compressed_body_is_a_415(client: httpx.Client) -> None:
    headers = {"Content-Type": "application/json", "Content-Encoding": "gzip"}
    answer = client.post("/v1/plans", content=gzip.compress(json.dumps(task()).encode()), headers=headers)
    assert (answer.status_code, answer.headers["Accept-Encoding"]) == (415, "identity")


def test_a_body_that_is_announced_too_large_is_refused_before_it_is_sent(address: str) -> None:
    host, port = address.removeprefix("http://").split(":")
    with socket.create_connection((host, int(port)), timeout=LONGEST_SECONDS) as connection:
        connection.sendall(
            b"POST /v1/plans HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\n"
            b"Content-Length: 10000000\r\nExpect: 100-continue\r\n\r\n"
        )
        assert connection.recv(100).startswith(b"HTTP/1.1 413 ")


def test_an_id_of_any_length_and_kind_names_no_plan(client: httpx.Client) -> None:
    for plan_id in ("%00", "%ff", "..%2f..%2fetc%2fpasswd", "a" * 30_000):
        answer = client.get(f"/v1/plans/{plan_id}")
        assert answer.status_code == 404
        assert len(answer.content) < 1000


@pytest.mark.parametrize("key", ["a b", "", '""', "a" * 256, "a" * 50_000])
def test_an_idempotency_key_that_cannot_be_one_is_refused(client: httpx.Client, key: str) -> None:
    headers = {"Content-Type": "application/json", "Idempotency-Key": key}
    assert client.post("/v1/plans", content=json.dumps(task()).encode(), headers=headers).status_code == 400


def test_a_parameter_that_is_missing_is_told_its_choices(client: httpx.Client) -> None:
    answer = client.get("/v1/plans/none/program.zip")
    assert answer.status_code == 422
    (error,) = answer.json()["errors"]
    assert error["allowed"] == [target.value for target in ProgramTarget]
    assert error["detail"] == f"is required: one of {', '.join(error['allowed'])}"
