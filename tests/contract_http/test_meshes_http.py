"""Uploading meshes over HTTP, and tasks that name them."""

from __future__ import annotations

import time
from typing import Any

import httpx
import pytest
import trimesh

from tests.geometry.mesh_shapes import angle, file_of
from tests.support.service import task

MEDIA = {"stl": "model/stl", "obj": "model/obj", "ply": "model/ply", "glb": "model/gltf-binary"}


def upload(client: httpx.Client, content: bytes, media: str = "model/stl") -> httpx.Response:
    return client.post("/v1/meshes", content=content, headers={"Content-Type": media})


@pytest.mark.parametrize("kind", MEDIA)
def test_a_mesh_is_taken_as_bytes_or_in_a_form_and_has_one_id(client: httpx.Client, kind: str) -> None:
    content = file_of(angle(), kind)
    first = upload(client, content, MEDIA[kind])
    assert first.status_code == 201, first.text
    mesh = first.json()
    assert mesh["size"] == pytest.approx([0.1, 0.08, 0.05])
    assert mesh["centroid"] == pytest.approx(angle().center_mass.tolist())
    assert (mesh["triangles"], mesh["convex_parts"], mesh["hint"]) == (20, 2, None)
    assert first.headers["location"] == mesh["links"]["self"] == f"/v1/meshes/{mesh['id']}"
    assert client.get(mesh["links"]["self"]).json() == mesh
    assert upload(client, content, MEDIA[kind]).json()["id"] == mesh["id"]
    for name, media in ((f"part.{kind}", "application/octet-stream"), ("part", MEDIA[kind])):
        form = client.post("/v1/meshes", files={"file": (name, content, media)}, data={"note": "an angle"})
        assert (form.status_code, form.json()) == (201, mesh)


def test_a_mesh_in_millimetres_is_taken_with_a_hint(client: httpx.Client) -> None:
    answer = upload(client, file_of(trimesh.creation.box((130, 70, 20)), "stl"))
    assert answer.status_code == 201
    assert "scale 0.001" in answer.json()["hint"]


FORM = "multipart/form-data; boundary=x"
OPEN = trimesh.Trimesh(angle().vertices, angle().faces[1:], process=False)


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (file_of(OPEN, "stl"), "open: 3 edges belong to one triangle only"),
        (file_of(trimesh.creation.icosphere(6), "stl"), "81920 triangles"),
        (b"not a mesh", "no STL file"),
        (b"", "no STL file"),
    ],
)
def test_a_mesh_that_cannot_be_used_is_refused_with_the_reason(
    client: httpx.Client, content: bytes, reason: str
) -> None:
    answer = upload(client, content)
    assert answer.status_code == 422
    assert answer.headers["content-type"] == "application/problem+json"
    (problem,) = answer.json()["errors"]
    assert problem["pointer"] == ""
    assert reason in problem["detail"]


@pytest.mark.parametrize("media", ["application/json", "model/step", "application/octet-stream"])
def test_what_is_not_declared_as_a_mesh_is_unsupported(client: httpx.Client, media: str) -> None:
    answer = upload(client, file_of(angle(), "stl"), media)
    assert answer.status_code == 415
    assert "model/stl" in answer.headers["accept-post"]


@pytest.mark.parametrize(
    ("body", "media", "status"),
    [
        (b"", "multipart/form-data", 422),
        (b"anything", FORM, 422),
        (b"--x\r\n\r\n\r\n--x--\r\n", FORM, 422),
        (b'--x\r\nContent-Disposition: form-data; name="mesh"\r\n\r\nabc\r\n--x--\r\n', FORM, 422),
        (b'--x\r\nContent-Disposition: form-data; name="file"\r\n\r\nabc\r\n--x--\r\n', FORM, 415),
        (b'--x\r\nContent-Disposition: form-data; name="file"; filename="a.stl"\r\n\r\nabc', FORM, 422),
    ],
)  # fmt: skip
def test_a_form_without_a_file_is_refused(client: httpx.Client, body: bytes, media: str, status: int) -> None:
    answer = upload(client, body, media)
    assert answer.status_code == status
    assert answer.headers["content-type"] == "application/problem+json"


def test_a_file_that_is_no_mesh_is_called_by_its_name_and_its_type(client: httpx.Client) -> None:
    head = b'--x\r\nContent-Disposition: form-data; name="file"; filename="readme.md"\r\n'
    for header, told in ((b"Content-Type: text/markdown\r\n", "'text/markdown'"), (b"", "missing")):
        detail = upload(client, head + header + b"\r\nabc\r\n--x--\r\n", FORM).json()["detail"]
        assert detail.startswith(f"the type of the file 'readme.md' is {told}; it must be one of ")


def test_bytes_of_a_file_that_look_like_a_boundary_stay_in_it(client: httpx.Client) -> None:
    text = file_of(angle(), "obj") + b"\r\n# --x--\r\n#--x\r\n\r\n"
    head = b'--x\r\nContent-Disposition: form-data; name="file"; filename="A.OBJ"\r\n\r\n'
    answer = upload(client, head + text + b"\r\n--x--\r\n", FORM)
    assert answer.json()["id"] == upload(client, text, "model/obj").json()["id"]


def test_an_upload_that_is_too_large_is_refused(client: httpx.Client) -> None:
    answer = upload(client, b"\0" * 20_000_001)
    assert answer.status_code == 413


def test_there_is_no_mesh_of_an_unknown_id(client: httpx.Client) -> None:
    answer = client.get("/v1/meshes/0123")
    assert (answer.status_code, answer.json()["title"]) == (404, "No such mesh")


def with_object(shape: dict[str, Any]) -> dict[str, Any]:
    pose = [0.45, 0.1, 1.094, 1, 0, 0, 0]
    one = {"name": "angle", "shape": shape, "mass": 0.1, "com": [0.03, 0.02, 0.025], "pose": pose, "goal_pose": pose}
    return task("domino_pile.json", objects=[one])


def test_a_task_that_names_an_upload_is_planned_with_it(client: httpx.Client) -> None:
    mesh = upload(client, file_of(angle(), "stl")).json()["id"]
    plan = client.post("/v1/plans", json=with_object({"type": "mesh", "upload": mesh}))
    assert plan.status_code == 202, plan.text
    address = plan.json()["links"]["self"]
    while not (resource := client.get(address).json())["done"]:
        time.sleep(0.05)
    assert client.get(resource["links"]["document"]).json()["meshes"] == [mesh]


@pytest.mark.parametrize(
    ("shape", "pointer"),
    [
        ({"type": "mesh", "upload": "0123"}, "/objects/0/shape/upload"),
        ({"type": "mesh", "asset": "teapot"}, "/objects/0/shape/asset"),
        ({"type": "mesh", "asset": "can", "scale": 1000}, "/objects/0/shape/scale"),
        ({"type": "mesh", "asset": "can", "upload": "0123"}, "/objects/0/shape"),
    ],
)
def test_a_mesh_that_is_not_there_is_pointed_at(client: httpx.Client, shape: dict[str, Any], pointer: str) -> None:
    answer = client.post("/v1/plans", json=with_object(shape))
    assert answer.status_code == 422
    assert [problem["pointer"] for problem in answer.json()["errors"]] == [pointer]
