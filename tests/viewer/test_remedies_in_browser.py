"""A plan that was not found tells what to change; a click on it has the changed task planned, and its plan plays."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Page, expect

from tests.support.browser import LOADING_MILLISECONDS, draw_no_scene, needs_browser, running_browser, wait_for_plan
from tests.support.plan_shelf import PlanShelf
from tests.support.service import ServiceProcess, finished, running_service, task

UNSOLVED, SOLVED = "pb1_weak_cup", "ab1"
"""Shipped tasks: the solver answers a task by its `external_id`, which the first remedy changes too."""
FAILS = "fails in physics"
FORCE = 31.0
REMEDIES = [
    {
        "kind": "cup_force",
        "sentence": "Use a cup that bears 31 N.",
        "patch": [
            {"op": "replace", "path": "/cup/max_force", "value": FORCE},
            {"op": "replace", "path": "/external_id", "value": SOLVED},
        ],
        "outcome": "solved",
        "certified": True,
        "reserve": 0.125,
        "largest_force": 18.3,
    },
    {
        "kind": "support",
        "sentence": "Leave the support out.",
        "patch": [{"op": "remove", "path": "/nothing/of/this/name"}],
        "outcome": "solved",
        "certified": True,
        "reserve": None,
        "largest_force": None,
    },
]
"""The second one fits no task."""

pytestmark = [needs_browser, pytest.mark.slow]


@pytest.fixture(scope="module")
def service(shelf: PlanShelf, data_dir: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[ServiceProcess]:
    folder = tmp_path_factory.mktemp("documents")
    documents = {name: shelf.document(task(f"{name}.json")) for name in (UNSOLVED, SOLVED)}
    for name, remedies in ((UNSOLVED, REMEDIES), ("none helps", [])):
        told = {**documents[UNSOLVED]["explanation"], "remedies": remedies}
        documents[name] = {**documents[UNSOLVED], "explanation": told}
    failed = {**documents[SOLVED]["simulation"], "outcome": "slipped", "cause": "the stick slid"}
    for name, remedies in ((FAILS, [{**remedy, "simulated": True} for remedy in REMEDIES]), ("nothing mends", [])):
        told = {**documents[SOLVED]["explanation"], "remedies": remedies}
        documents[name] = {**documents[SOLVED], "explanation": told, "simulation": failed}
    for name, document in documents.items():
        (folder / f"{name}.json").write_text(json.dumps(document))
    solver = (sys.executable, "-m", "tests.support.document_solver", str(folder))
    with running_service(data_dir, solver) as service:
        yield service


@pytest.fixture(scope="module")
def window() -> Iterator[Page]:
    """Return a window without the scene's picture."""
    with running_browser() as browser:
        page = browser.new_page(viewport={"width": 1280, "height": 720}, device_scale_factor=0.5)
        page.set_default_timeout(LOADING_MILLISECONDS)
        draw_no_scene(page)
        yield page


def open_plan(page: Page, service: ServiceProcess, name: str) -> dict[str, Any]:
    """Post the unsolved task under a name and look at what came of it."""
    with service.client() as client:
        posted = client.post("/v1/plans", json=task(f"{UNSOLVED}.json", external_id=name))
        plan = finished(client, posted.raise_for_status().json())
    page.goto(service.address + plan["links"]["view"])
    page.wait_for_function("(id) => player.description?.id === id", arg=plan["id"])
    return plan


def test_the_first_remedy_is_applied_by_one_click_and_its_plan_plays(window: Page, service: ServiceProcess) -> None:
    plan = open_plan(window, service, UNSOLVED)
    first = window.locator("#tab-body > *").nth(1).locator("li").first
    assert REMEDIES[0]["sentence"] in first.inner_text()
    for figure in ("certified", "12.5 %", "18.3 N"):
        assert figure in first.inner_text()
    with window.expect_request(lambda request: request.method == "POST") as posted:
        first.get_by_role("button").click()
    sent = posted.value.post_data_json
    assert sent is not None
    assert sent["cup"]["max_force"] == FORCE
    assert sent["plate"]["mass"] == task(f"{UNSOLVED}.json")["plate"]["mass"]
    wait_for_plan(window, SOLVED)
    assert window.evaluate("wanted") != plan["id"]
    assert window.evaluate("wanted") in window.url
    window.locator("#play").click()
    window.wait_for_function("player.time > 0.5")


@pytest.mark.slow
def test_a_remedy_that_does_not_fit_is_told_but_offers_no_button(window: Page, service: ServiceProcess) -> None:
    open_plan(window, service, UNSOLVED)
    second = window.locator(".remedies li").nth(1)
    assert REMEDIES[1]["sentence"] in second.inner_text()
    assert second.get_by_role("button").count() == 0


def test_that_no_change_helps_is_said(window: Page, service: ServiceProcess) -> None:
    open_plan(window, service, "none helps")
    assert "No single change" in window.locator("#tab-body").inner_text()


def test_what_physics_carries_out_is_told_beside_a_plan_that_fails_there(window: Page, service: ServiceProcess) -> None:
    open_plan(window, service, FAILS)
    expect(window.locator("#tab-body")).to_contain_text("fails in physics. What mends that:")
    first = window.locator(".remedies li").first
    assert "carried out in physics" in first.inner_text()
    first.get_by_role("button").click()
    wait_for_plan(window, SOLVED)
    expect(window.locator("#tab-body")).not_to_contain_text("What mends that")
    open_plan(window, service, "nothing mends")
    expect(window.locator("#tab-body")).to_contain_text("No change that was tried mends that.")


@pytest.mark.slow
def test_a_task_that_is_refused_says_why(window: Page, service: ServiceProcess) -> None:
    open_plan(window, service, UNSOLVED)
    window.evaluate("player.description.remedies[0].task.cup.radius = -1, player.panel.open('View')")
    window.locator(".remedies button").first.click()
    window.wait_for_function("document.getElementById('message').innerText.includes('/cup/radius')")
