"""A repeat finds the plan that the first post made, whatever has changed meanwhile; another task does not."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from typing import Any

import httpx
import pytest
import sqlalchemy as sa

from app import task_intake
from app.resources import plan_collection
from app.settings import ServiceSettings
from planners.contract.task_spec import read_task, write_task
from planners.errors import SceneError
from tests.geometry.mesh_shapes import angle, file_of
from tests.support.service import FAKE_SOLVER, task
from tests.support.serving import served
from workers.stores.database import SQLITE_FILE
from workers.stores.tables import PLANS


@pytest.fixture(scope="module")
def settings(tmp_path_factory: pytest.TempPathFactory) -> ServiceSettings:
    return ServiceSettings(data_dir=tmp_path_factory.mktemp("data"), solver_command=FAKE_SOLVER)


@pytest.fixture(scope="module")
def client(settings: ServiceSettings) -> Iterator[httpx.Client]:
    with served(settings, with_worker=False) as address, httpx.Client(base_url=address, timeout=30.0) as client:
        yield client


def post(client: httpx.Client, body: Any, key: str) -> httpx.Response:
    content = body if isinstance(body, bytes) else json.dumps(body).encode()
    headers = {"Idempotency-Key": key, "Content-Type": "application/json"}
    return client.post("/v1/plans", content=content, headers=headers)


def forget_what_was_sent(settings: ServiceSettings, plan: dict[str, Any]) -> None:
    """Make a plan one of those that were posted before it was kept."""
    engine = sa.create_engine(f"sqlite:///{settings.data_dir / SQLITE_FILE}")
    with engine.begin() as transaction:
        own = sa.update(PLANS).where(PLANS.c.id == plan["id"])
        transaction.execute(own.values(sent_fingerprint=None, fingerprint="0" * 64))
    engine.dispose()


def with_a_new_member(given: Any) -> dict[str, Any]:
    """Fill in what a later version would."""
    return {**write_task(given), "member_of_later": None}


def test_an_upgrade_that_adds_a_member_with_a_default_does_not_make_it_another_task(
    client: httpx.Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = post(client, task(), "upgrade").raise_for_status().json()
    monkeypatch.setattr(plan_collection, "write_task", with_a_new_member)
    again = post(client, task(), "upgrade")
    assert (again.status_code, again.json().get("id")) == (202, first["id"])


def test_what_a_task_names_may_be_gone_when_it_is_repeated(
    client: httpx.Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = post(client, task(), "gone").raise_for_status().json()

    def nothing_is_there(*_: Any, **__: Any) -> None:
        raise SceneError("/scene_id", "there is no such scene")

    monkeypatch.setattr(task_intake, "with_scene", nothing_is_there)
    assert post(client, task(), "another").status_code == 422
    again = post(client, task(), "gone")
    assert (again.status_code, again.json().get("id")) == (202, first["id"])


def test_the_same_task_in_other_words_is_the_same(client: httpx.Client) -> None:
    first = post(client, task(), "words").raise_for_status().json()
    turned = json.dumps(dict(reversed(task().items())), indent=3).encode()
    for again in (post(client, turned, "words"), post(client, write_task(read_task(task())), "words")):
        assert (again.status_code, again.json().get("id")) == (202, first["id"])


def test_a_centre_of_mass_that_is_left_out_is_the_same_as_the_one_that_it_stands_for(client: httpx.Client) -> None:
    answer = client.post("/v1/meshes", content=file_of(angle(), "stl"), headers={"Content-Type": "model/stl"})
    mesh = answer.raise_for_status().json()
    pose = [0.45, 0.1, 1.094, 1, 0, 0, 0]
    shape = {"type": "mesh", "upload": mesh["id"]}
    part = {"name": "part", "shape": shape, "mass": 0.1, "pose": pose, "goal_pose": pose}
    left_out = task("domino_pile.json", objects=[part])
    first = post(client, left_out, "centre").raise_for_status().json()
    stated = task("domino_pile.json", objects=[{**part, "com": [round(value, 9) for value in mesh["centroid"]]}])
    for again in (post(client, left_out, "centre"), post(client, stated, "centre")):
        assert (again.status_code, again.json().get("id")) == (202, first["id"])
    at_origin = task("domino_pile.json", objects=[{**part, "com": [0, 0, 0]}])
    assert post(client, at_origin, "centre").status_code == 422


def test_another_task_is_refused_and_so_is_one_that_cannot_be_planned(client: httpx.Client) -> None:
    post(client, task(), "other").raise_for_status()
    for body, title in ((task(seed=9), "Idempotency key used twice"), (task(kind="dance"), "The task is not valid")):
        answer = post(client, body, "other")
        assert (answer.status_code, answer.json()["title"]) == (422, title)


def test_plans_of_before_are_found_by_what_they_were_taken_for(client: httpx.Client, settings: ServiceSettings) -> None:
    first = post(client, task(), "old").raise_for_status().json()
    forget_what_was_sent(settings, first)
    again = post(client, task(), "old")
    assert (again.status_code, again.json().get("id")) == (202, first["id"])
    assert post(client, task(seed=9), "old").status_code == 422


def test_the_version_before_knows_a_repeat_as_it_did(client: httpx.Client, settings: ServiceSettings) -> None:
    """Services are upgraded one by one: a repeat may reach the older one, which compares tasks as accepted."""
    plan = post(client, task(), "mixed").raise_for_status().json()
    engine = sa.create_engine(f"sqlite:///{settings.data_dir / SQLITE_FILE}")
    with engine.connect() as connection:
        row = connection.execute(sa.select(PLANS.c.fingerprint, PLANS.c.task).where(PLANS.c.id == plan["id"])).one()
    engine.dispose()
    accepted = json.dumps(json.loads(row.task), sort_keys=True).encode()
    assert row.fingerprint == hashlib.sha256(accepted).hexdigest()
