"""From cameras to a plan, as a factory would: a scan is posted, a task names its scene, the plan is certified."""

from __future__ import annotations

import json
from collections.abc import Iterator

import httpx
import numpy as np
import pytest

from tests.support.scan_frames import PILES, SHIPPED, Scan, pile
from tests.support.service import ServiceProcess, finished, running_service, warmed

pytestmark = pytest.mark.slow
REACHED = 1e-3


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ServiceProcess]:
    with running_service(warmed(tmp_path_factory.mktemp("data")), None, solver_niceness=0) as service:
        yield service


@pytest.fixture(scope="module")
def scan() -> Scan:
    return pile(seed=7)


@pytest.mark.parametrize("name", PILES)
def test_objects_and_a_tool_that_cameras_see_are_piled_up_by_a_certified_plan(
    service: ServiceProcess, name: str
) -> None:
    with service.client() as client:
        scene = posted(client, pile(name, seed=7))
        task = json.loads((SHIPPED / name / "task.json").read_text())
        answer = client.post("/v1/plans", json={**task, "scene_id": scene["id"]})
        assert answer.status_code == 202, answer.text
        plan = finished(client, answer.json())
        assert (plan["state"], plan["outcome"]) == ("succeeded", "solved"), plan["error"]
        document = client.get(plan["links"]["document"]).json()
    assert document["certificate"]["passed"] is True
    assert document["task"]["scene_id"] == scene["id"]
    last = {name: poses[-1] for segment in document["segments"] for name, poses in segment["body_poses"].items()}
    for given in document["task"]["objects"]:
        assert np.linalg.norm(np.subtract(last[given["name"]][:3], given["goal_pose"][:3])) < REACHED


def test_errors_of_sides_are_about_as_large_as_told(service: ServiceProcess, scan: Scan) -> None:
    """Of three boxes' six sides, no more than one is off by more than two of the deviations that are told."""
    with service.client() as client:
        scene = posted(client, scan)
    outside = 0
    for seen in scene["scene"]["objects"]:
        true = min(scan.objects, key=lambda one: np.linalg.norm(one.T_world_object[:3, 3] - seen["pose"][:3]))
        off = np.abs(np.subtract(seen["shape"]["size"][:2], true.size[:2]))
        outside += int((off > 2.0 * np.array(seen["uncertainty"]["size"][:2])).sum())
    assert outside <= 1


def posted(client: httpx.Client, scan: Scan) -> dict:
    answer = client.post("/v1/scenes", files=scan.form())
    assert answer.status_code == 201, answer.text
    return answer.json()
